"use strict";
// The page of `servoctl scope`: news from the drive in, wishes out.

const $ = (id) => document.getElementById(id);
const token = document.querySelector("meta[name=token]").content;
const socket = new WebSocket(`ws://${location.host}/link?token=${token}`);
const me = { number: 0, commands: false };

function wish(what) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(what));
  else say("not connected: load the page again", true);
}

function say(text, refused) {
  $("message").textContent = text;
  $("message").classList.toggle("refused", Boolean(refused));
}

// ---- plots -------------------------------------------------------------------------------------------------------------

const COLOURS = { position: "#1f5fa8", error: "#a03a78", force: "#2d7d46", before: "#c3ccd6" };

/** A time plot; grows with its element. */
function timePlot(element, label, unit, xLabel, colour, height, range) {
  const options = {
    width: element.clientWidth || 300, height,
    legend: { show: false }, cursor: { drag: { x: true, y: false } },
    scales: { x: { time: false }, y: range ? { range } : {} },
    series: [{}, { label, stroke: colour, width: 1.3, points: { show: false } }],
    axes: [
      { label: xLabel, size: 46, labelSize: 18, values: (_, ticks) => ticks.map((t) => +t.toFixed(4)) },
      { label: `${label}, ${unit}`, size: 66, labelSize: 18 },
    ],
  };
  const plot = new uPlot(options, [[], []], element);
  new ResizeObserver(() => plot.setSize({ width: element.clientWidth, height })).observe(element);
  return plot;
}

/** Force over displacement: the present loop over the one before. */
function loopPlot(element) {
  const draw = (colour) => (u, index) => {
    const [xs, ys] = u.data[index];
    const path = new Path2D();
    for (let i = 0; i < xs.length; i++) {
      path.lineTo(u.valToPos(xs[i], "x", true), u.valToPos(ys[i], "y", true));
    }
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    u.ctx.clip();
    u.ctx.strokeStyle = colour;
    u.ctx.lineWidth = 1.5 * devicePixelRatio;
    u.ctx.stroke(path);
    u.ctx.restore();
    return null;
  };
  const span = (axis) => (u) => {
    const all = [1, 2].flatMap((s) => (u.data[s] ? Array.from(u.data[s][axis]) : []));
    if (all.length === 0) return [-1, 1];
    const [low, high] = all.reduce(([l, h], v) => [Math.min(l, v), Math.max(h, v)], [Infinity, -Infinity]);
    const margin = (high - low || 1) * 0.05;
    return [low - margin, high + margin];
  };
  const options = {
    mode: 2, width: element.clientWidth || 300, height: 260, legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: false, range: span(0) }, y: { range: span(1) } },
    series: [{}, { paths: draw(COLOURS.before), stroke: COLOURS.before }, { paths: draw(COLOURS.force), stroke: COLOURS.force }],
    axes: [{ label: "position − target, µm", size: 46, labelSize: 18 }, { label: "force, N", size: 66, labelSize: 18 }],
  };
  const plot = new uPlot(options, [null, [[], []], [[], []]], element);
  new ResizeObserver(() => plot.setSize({ width: element.clientWidth, height: 260 })).observe(element);
  return plot;
}

const plots = {};
const settleRange = () => {
  const nm = Number($("scale").value);
  return nm ? [-nm, nm] : null;
};

function makePlots() {
  if (typeof uPlot === "undefined") {
    for (const id of ["live-position", "live-error", "live-force", "settle", "loop"]) {
      $(id).textContent = "no plots in this build: `cargo xtask web` fetches them, then build servoctl again";
    }
    return;
  }
  plots.position = timePlot($("live-position"), "position", "mm", "", COLOURS.position, 150);
  plots.error = timePlot($("live-error"), "error", "nm", "", COLOURS.error, 170);
  plots.force = timePlot($("live-force"), "force", "N", "time on the drive's clock, s", COLOURS.force, 170);
  plots.settle = timePlot($("settle"), "error", "nm", "ms after the end of the profile", COLOURS.error, 260,
    (_, low, high) => settleRange() || [low, high]);
  plots.loop = loopPlot($("loop"));
}

// ---- live traces -------------------------------------------------------------------------------------------------------

const live = { time_s: [], position_mm: [], error_nm: [], force_n: [], held: false, from: null, armed: true, wasMoving: false };
const KEPT_S = 30;

function addLive(news) {
  const last = live.time_s.at(-1);
  if (news.time_s.length && last !== undefined && news.time_s[0] < last) {
    for (const key of ["time_s", "position_mm", "error_nm", "force_n"]) live[key] = []; // the drive has started anew
    live.from = null;
  }
  for (const key of ["time_s", "position_mm", "error_nm", "force_n"]) live[key].push(...news[key]);
  const old = live.time_s.findIndex((t) => t > live.time_s.at(-1) - KEPT_S);
  if (old > 2000) for (const key of ["time_s", "position_mm", "error_nm", "force_n"]) live[key].splice(0, old);
  const at = live.time_s.length - 1;
  if (at < 0) return;
  $("position").textContent = `${live.position_mm[at].toFixed(6)} mm`;
  $("error").textContent = `${live.error_nm[at].toFixed(1)} nm`;
  $("force").textContent = `${live.force_n[at].toFixed(3)} N`;
  trigger(news);
  drawLive();
}

/** A trigger freezes the window that begins where it was met, until the next one. */
function trigger(news) {
  const kind = $("trigger").value;
  if (!kind) { live.from = null; return; }
  const window_s = Number($("window").value);
  const now = live.time_s.at(-1);
  if (live.from !== null && now < live.from + 0.9 * window_s) return;
  if (kind === "error") {
    const level = Number($("level").value);
    const hit = news.error_nm.findIndex((e) => Math.abs(e) > level);
    if (hit >= 0) live.from = news.time_s[hit] - 0.1 * window_s;
  }
}

function drawLive() {
  if (live.held || !plots.position) return;
  const window_s = Number($("window").value);
  const triggered = live.from !== null;
  const end = triggered ? live.from + window_s : live.time_s.at(-1);
  const first = Math.max(0, live.time_s.findIndex((t) => t >= end - window_s));
  const beyond = live.time_s.findIndex((t) => t > end);
  const cut = (column) => column.slice(first, beyond < 0 ? undefined : beyond);
  const time = cut(live.time_s);
  for (const [plot, key] of [[plots.position, "position_mm"], [plots.error, "error_nm"], [plots.force, "force_n"]]) {
    plot.setData([time, cut(live[key])]);
  }
}

// ---- moves -------------------------------------------------------------------------------------------------------------

const moves = new Map();
let captured = null;

function addSettled(news) {
  const list = moves.get(news.compensator) || [];
  list.push(news.report);
  moves.set(news.compensator, list);
  const rows = [...moves].map(([name, reports]) => {
    const mean = (values) => values.includes(null) ? "–" : (values.reduce((a, b) => a + b, 0) / values.length).toFixed(1);
    const cells = reports[0].tolerances_nm.map((_, i) => mean(reports.map((r) => r.settled_after_ms[i])));
    const rms = reports.at(-1).in_position_rms_nm;
    return [name, reports.length, ...cells, rms === null ? "–" : `${rms.toFixed(2)} nm`];
  });
  $("settled").tBodies[0].replaceChildren(...rows.map(tableRow));
  say(`settled: ${news.from_mm.toFixed(4)} → ${news.to_mm.toFixed(4)} mm, ${news.compensator}`);
}

function tableRow(cells) {
  const row = document.createElement("tr");
  for (const cell of cells) {
    const data = document.createElement("td");
    data.append(cell);
    row.append(data);
  }
  return row;
}

function addCaptured(news) {
  const before = captured;
  captured = news;
  $("save-capture").disabled = false;
  if (!plots.settle) return;
  plots.settle.setData([news.time_ms, news.error_nm]);
  const old = before ? [before.displacement_um, before.force_n] : [[], []];
  plots.loop.setData([null, old, [news.displacement_um, news.force_n]]);
}

// ---- parameters --------------------------------------------------------------------------------------------------------

function showParameters(rows) {
  const body = $("parameters").tBodies[0];
  if (body.rows.length !== rows.length) {
    body.replaceChildren(...rows.map((row) => {
      const input = document.createElement("input");
      input.dataset.name = row.name;
      input.setAttribute("aria-label", row.name);
      const limits = `${short(row.min)} … ${short(row.max)}${row.bridge_off ? ", bridge off" : ""}`;
      return tableRow([row.name, input, row.unit, limits, row.doc]);
    }));
    find();
  }
  rows.forEach((row, index) => {
    const input = body.rows[index].querySelector("input");
    if (input !== document.activeElement) input.value = short(row.value);
    if (row.name === "compensator" && ["0", "1"].includes(String(row.value))) $("compensator").value = String(row.value);
  });
}

const short = (value) => String(Number(value.toPrecision(10)));

function find() {
  const text = $("find").value.trim().toLowerCase();
  for (const row of $("parameters").tBodies[0].rows) row.hidden = !row.textContent.toLowerCase().includes(text);
}

// ---- news --------------------------------------------------------------------------------------------------------------

const news = {
  hello(n) {
    me.number = n.you;
    $("drive").textContent = n.drive;
    $("simulated").hidden = !n.simulated;
  },
  state(n) {
    $("state").textContent = n.moving ? `${n.state}, moving` : n.state;
    $("bus").textContent = `${n.bus_v.toFixed(1)} V`;
    $("fault").hidden = n.fault === null;
    if (n.fault) $("fault").firstElementChild.textContent = `Fault ${n.fault[0]}: ${n.fault[1]}`;
    const window_s = Number($("window").value);
    if ($("trigger").value === "move" && n.moving && !live.wasMoving) live.from = n.time_s - 0.1 * window_s;
    live.wasMoving = n.moving;
  },
  live: addLive,
  settled: addSettled,
  captured: addCaptured,
  parameters(n) { showParameters(n.rows); },
  commander(n) {
    me.commands = n.holder === me.number;
    $("commander").textContent = n.holder === null ? "nobody commands: the first who presses a button does"
      : me.commands ? "you command" : `browser ${n.holder} commands; you look`;
    $("release").hidden = !me.commands;
  },
  answer(n) { say(n.text, !n.done); },
  ended(n) { say(n.text, true); $("state").textContent = "not connected"; },
};

socket.onmessage = (event) => {
  const message = JSON.parse(event.data);
  news[message.type]?.(message);
};
socket.onclose = () => { say("the connection to servoctl is closed: load the page again", true); $("state").textContent = "not connected"; };

// ---- what a person does ------------------------------------------------------------------------------------------------

document.addEventListener("click", (event) => {
  const { do: what, jog } = event.target.dataset ?? {};
  if (what) wish({ do: what });
  if (jog) wish({ do: "move", target: jog, relative: true, acceleration: $("acceleration").value });
});
$("stop").onclick = () => wish({ do: "stop" });
$("move").onsubmit = (event) => {
  event.preventDefault();
  wish({ do: "move", target: $("target").value, acceleration: $("acceleration").value });
};
document.addEventListener("keydown", (event) => {
  const typing = event.target.matches("input, select, textarea");
  if (event.code === "Space" && !typing) {
    event.preventDefault(); // not the button that happens to have the focus
    wish({ do: "stop" });
  }
});
$("compensator").onchange = () => wish({ do: "set", name: "compensator", value: $("compensator").value });
$("parameters").addEventListener("change", (event) => {
  if (event.target.dataset.name) wish({ do: "set", name: event.target.dataset.name, value: event.target.value });
});
$("find").oninput = find;
$("hold").onclick = () => {
  live.held = !live.held;
  $("hold").setAttribute("aria-pressed", live.held);
};
$("scale").onchange = () => captured && plots.settle?.setData([captured.time_ms, captured.error_nm]);

function save(name, columns) {
  const keys = Object.keys(columns);
  const lines = columns[keys[0]].map((_, i) => keys.map((key) => columns[key][i]).join(","));
  const text = [`# ${$("drive").textContent}`, keys.join(","), ...lines, ""].join("\n");
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}
$("save-live").onclick = () => {
  const { time_s, position_mm, error_nm, force_n } = live;
  save("live.csv", { time_s, position_mm, error_nm, force_n });
};
$("save-capture").onclick = () => {
  const { time_ms, error_nm, displacement_um, force_n } = captured;
  save("move.csv", { time_ms, error_nm, displacement_um, force_n });
};

makePlots();
