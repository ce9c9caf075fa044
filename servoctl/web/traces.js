// The three plots: live signals, error after the last moves, force over position.

import uPlot from "./uPlot.esm.js";
import { download } from "./csv.js";
import { origin } from "./settling.js";
import { Trigger } from "./trigger.js";
import { fixed, lengthUnit, parse } from "./units.js";

const at = (id) => document.getElementById(id);
/// Longest live view, s, and what is kept for it.
const KEPT_S = 60;
const HEIGHT = 230;

const live = { time_s: [], error_nm: [], position_m: [], force_n: [] };
const captures = [];
const trigger = new Trigger();
let loopFrom = 0;
let held = null;
let plots = {};
let due = false;

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/// Buttons, and the plots.
export function wireTraces(known) {
  for (const id of ["signal", "span", "live-scale", "settling-scale", "loop-scale"]) at(id).addEventListener("change", redraw);
  at("hold").addEventListener("click", () => {
    held = held ? null : window_();
    at("hold").setAttribute("aria-pressed", String(held !== null));
    redraw();
  });
  at("loop-clear").addEventListener("click", () => {
    loopFrom = live.time_s.at(-1) ?? 0;
    redraw();
  });
  at("live-csv").addEventListener("click", () => liveCsv(known));
  at("capture-csv").addEventListener("click", () => captureCsv(known));
  for (const id of ["trigger", "level", "single", "signal"]) at(id).addEventListener("change", setTrigger);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
  new ResizeObserver(resize).observe(at("live"));
  new ResizeObserver(resize).observe(at("loop"));
  build();
}

function setTrigger() {
  const unit = at("signal").value === "force" ? "N" : "m";
  if (document.activeElement !== at("level") && !at("level").value.trim().endsWith(unit)) {
    at("level").value = unit === "N" ? "0.1 N" : "50 nm";
  }
  try {
    const size = at("signal").value === "error" ? 1e9 : 1;
    trigger.level = parse(at("level").value, unit) * size;
    trigger.mode = at("trigger").value;
    trigger.once = at("single").checked;
    trigger.arm(live.time_s.at(-1) ?? 0);
  } catch (error) {
    trigger.mode = "off";
    at("trigger").value = "off";
    at("trigger-state").textContent = error.message;
    return;
  }
  redraw();
}

/// More of the live traces.
export function addLive(samples) {
  // A clock that ran back is that of another drive.
  if (samples.time_s[0] < live.time_s.at(-1)) for (const column of Object.values(live)) column.length = 0;
  for (const [name, column] of Object.entries(live)) column.push(...samples[name]);
  const old = live.time_s.findIndex((time) => time >= live.time_s.at(-1) - KEPT_S);
  if (old > 5000) for (const column of Object.values(live)) column.splice(0, old);
  redraw();
}

/// A captured settling.
export function addCapture(capture) {
  if (captures.some((other) => other.number === capture.number)) return;
  captures.push(capture);
  if (captures.length > 8) captures.shift();
  at("capture-csv").disabled = false;
  redraw();
}

function redraw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    drawLive();
    drawSettling();
    drawLoop();
  });
}

// Live ---------------------------------------------------------------------------------------------------------------

function signal() {
  const name = at("signal").value;
  if (name === "error") return { values: live.error_nm, unit: "nm", size: 1 };
  if (name === "force") return { values: live.force_n, unit: "N", size: 1 };
  const span = Math.max(...live.position_m.map(Math.abs), 1e-9);
  const [unit, size] = lengthUnit(span);
  return { values: live.position_m, unit, size };
}

function window_() {
  return trigger.view(live.time_s, signal().values, Number(at("span").value));
}

function drawLive() {
  const { values, unit, size } = signal();
  const view = held ?? window_();
  at("trigger-state").textContent = view.state;
  const first = Math.max(0, live.time_s.findIndex((time) => time >= view.from) - 1);
  const x = live.time_s.slice(first);
  const y = values.slice(first).map((value) => value / size);
  const zero = trigger.mode !== "off" && trigger.fired !== null ? trigger.fired : view.to;
  plots.live.setData([x.map((time) => time - zero), y], false);
  plots.live.batch(() => {
    plots.live.setScale("x", { min: view.from - zero, max: view.to - zero });
    const shown = y.filter((_, i) => x[i] >= view.from && x[i] <= view.to);
    const [min, max] = at("signal").value === "error" ? around(shown, Number(at("live-scale").value), 5) : range(shown);
    plots.live.setScale("y", { min, max });
  });
  at("live").dataset.samples = String(shown(x, view));
  plots.live.axes[1].label = `${at("signal").value}, ${unit}`;
}

const shown = (x, view) => x.filter((time) => time >= view.from && time <= view.to).length;

/// Symmetric about zero: so wide, or as wide as the values need and at least `least`.
function around(values, fixedHalf, least) {
  const half = fixedHalf || Math.max(least, 1.1 * values.reduce((most, value) => Math.max(most, Math.abs(value)), 0));
  return [-half, half];
}

/// A little more than the values need.
function range(values) {
  if (!values.length) return [-1, 1];
  const [min, max] = values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  const margin = 0.08 * (max - min) || Math.max(1e-3, 0.1 * Math.abs(max));
  return [min - margin, max + margin];
}

function liveCsv(known) {
  const view = held ?? window_();
  const keep = live.time_s.map((time) => time >= view.from && time <= view.to);
  const kept = (values) => values.filter((_, i) => keep[i]);
  const columns = {
    time_s: kept(live.time_s),
    error_m: kept(live.error_nm).map(metres),
    position_m: kept(live.position_m).map((value) => fixed12(value)),
    force_n: kept(live.force_n),
  };
  const level = trigger.mode === "off" ? "none" : `${at("signal").value} ${trigger.mode} through ${at("level").value}`;
  download("live.csv", [...origin(known), "rate: 500 Hz; lost samples are missing rows", `trigger: ${level}`, UNITS], columns);
}

const UNITS = "units: s, m, m, N";
const metres = (nm) => (nm * 1e-9).toExponential(6);
const fixed12 = (value_m) => value_m.toFixed(12);

// Settling -----------------------------------------------------------------------------------------------------------

/// The last capture, and the last one with another compensator.
function pair() {
  const last = captures.at(-1);
  if (!last) return [];
  const other = captures.findLast((capture) => capture.compensator !== last.compensator);
  return [last, other].filter(Boolean);
}

function drawSettling() {
  const [last, other] = pair();
  if (!last) return drawNoSettling();
  const key = [last, other].map((capture) => capture?.number).join() + at("settling-scale").value;
  if (plots.settling.shown === key) return;
  plots.settling.shown = key;
  // One time axis: the finer of the two; where they differ, the other is drawn over its own samples.
  const times = last.error_nm.map((_, i) => (i - last.before) * last.sample_s * 1e3);
  const nearest = (t) => other?.error_nm[Math.round(t / 1e3 / other.sample_s) + other.before] ?? null;
  const second = times.map(nearest);
  plots.settling.setData([times, last.error_nm, second], false);
  const shown = [...last.error_nm, ...second.filter((value) => value !== null)];
  const [min, max] = around(shown, Number(at("settling-scale").value), 5);
  plots.settling.batch(() => {
    plots.settling.setScale("x", { min: times[0], max: times.at(-1) });
    plots.settling.setScale("y", { min, max });
  });
  at("settling").dataset.samples = String(last.error_nm.length);
  const caption = at("settling-caption");
  caption.replaceChildren(named(last, "c0"), ...(other ? [" ", named(other, "c1")] : []), " Dashed: ±3 nm.");
}

/// Before the first move: where its error will be drawn.
function drawNoSettling() {
  const [min, max] = around([], Number(at("settling-scale").value), 5);
  plots.settling.batch(() => {
    plots.settling.setScale("x", { min: -50, max: 500 });
    plots.settling.setScale("y", { min, max });
  });
}

function named(capture, mark) {
  const span = document.createElement("span");
  span.className = `key ${mark}`;
  span.textContent = `move ${capture.number}, ${capture.compensator}.`;
  return span;
}

function captureCsv(known) {
  const capture = captures.at(-1);
  const notes = [
    ...origin(known),
    `rate: ${1 / capture.sample_s} Hz`,
    `trigger: end of the profile, at 0 s, of move ${capture.number}, ${capture.compensator}`,
    UNITS,
  ];
  const time_s = capture.error_nm.map((_, i) => ((i - capture.before) * capture.sample_s).toFixed(6));
  const error_m = capture.error_nm.map(metres);
  const position_m = capture.position_nm.map((nm) => fixed12(capture.target_m + nm * 1e-9));
  download(`move-${capture.number}.csv`, notes, { time_s, error_m, position_m, force_n: capture.force_n });
}

// Force over position ------------------------------------------------------------------------------------------------

function drawLoop() {
  const span = Number(at("span").value);
  const now = live.time_s.at(-1) ?? 0;
  const first = live.time_s.findIndex((time) => time >= Math.max(now - 3 * span, loopFrom));
  if (first < 0) return;
  const positions = live.position_m.slice(first);
  const forces = live.force_n.slice(first);
  const [low, high] = positions.reduce(([a, b], p) => [Math.min(a, p), Math.max(b, p)], [Infinity, -Infinity]);
  const half = Number(at("loop-scale").value) || Math.max(5e-9, 0.55 * (high - low));
  const middle = Number(at("loop-scale").value) ? positions.at(-1) : (low + high) / 2;
  const [unit, size] = lengthUnit(half);
  const x = positions.map((p) => (p - middle) / size);
  plots.loop.setData([null, [x, forces], [[x.at(-1)], [forces.at(-1)]]], false);
  plots.loop.batch(() => {
    plots.loop.setScale("x", { min: -half / size, max: half / size });
    const [min, max] = range(forces);
    plots.loop.setScale("y", { min, max });
  });
  at("loop").dataset.samples = String(x.length);
  plots.loop.axes[0].label = `position − ${fixed(middle * 1e3, 4)} mm, ${unit}`;
}

/// Draws a series of mode 2 as a line, or its last point as a dot.
function path(u, index) {
  uPlot.orient(u, index, (series, _x, _y, scaleX, scaleY, toX, toY, left, top, width, height) => {
    const [xs, ys] = u.data[index];
    const { ctx } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    ctx.clip();
    ctx.beginPath();
    const point = (i) => [toX(xs[i], scaleX, width, left), toY(ys[i], scaleY, height, top)];
    ctx.strokeStyle = ctx.fillStyle = series.stroke(u, index);
    ctx.lineWidth = 1.5 * devicePixelRatio;
    ctx.lineJoin = "round";
    if (xs.length === 1) {
      ctx.arc(...point(0), 4 * devicePixelRatio, 0, 2 * Math.PI);
      ctx.fill();
    } else {
      for (let i = 0; i < xs.length; i++) ctx.lineTo(...point(i));
      ctx.stroke();
    }
    ctx.restore();
  });
  return null;
}

// Plots --------------------------------------------------------------------------------------------------------------

function axis(label, extra = {}) {
  const [ink, line] = [colour("--dim"), colour("--line")];
  const font = "12px system-ui, sans-serif";
  return { label, stroke: ink, font, labelFont: font, labelSize: 18, grid: { stroke: line, width: 1 }, ticks: { stroke: line, size: 4 }, ...extra };
}

const values = (_, ticks) => ticks.map((tick) => (tick === null ? "" : String(+tick.toPrecision(6)).replace("-", "−")));

function options(id, x, y, rest) {
  return {
    width: at(id).clientWidth || 300,
    height: HEIGHT,
    legend: { show: false },
    cursor: { drag: { x: false, y: false }, points: { show: false } },
    scales: { x: { time: false, auto: false, range: (_, min, max) => [min, max] }, y: { auto: false, range: (_, min, max) => [min, max] } },
    axes: [axis(x, { values, size: 28 }), axis(y, { values, size: 52 })],
    ...rest,
  };
}

/// ±3 nm, dashed, under the traces.
function tolerance(u) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.strokeStyle = colour("--dim");
  ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
  for (const nm of [-3, 3]) {
    const y = u.valToPos(nm, "y", true);
    if (y < bbox.top || y > bbox.top + bbox.height) continue;
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
  }
  ctx.restore();
}

/// Anew: the colours are those of the present scheme.
function build() {
  for (const plot of Object.values(plots)) plot.destroy();
  const line = (name, width = 1.5) => ({ stroke: colour(name), width, points: { show: false } });
  const facets = [{ scale: "x", auto: false }, { scale: "y", auto: false }];
  const mode2 = (name) => ({ facets, stroke: colour(name), paths: path });
  plots = {
    live: new uPlot(options("live", "time, s", "error, nm", { series: [{}, line("--c0")] }), [[], []], at("live")),
    settling: new uPlot(
      options("settling", "time after the profile, ms", "error, nm", {
        series: [{}, line("--c0"), line("--c1", 1)],
        hooks: { drawAxes: [tolerance] },
      }),
      [[], [], []],
      at("settling"),
    ),
    loop: new uPlot(
      options("loop", "position", "force, N", { mode: 2, series: [null, mode2("--c0"), mode2("--c1")] }),
      [null, [[], []], [[], []]],
      at("loop"),
    ),
  };
  redraw();
}

function resize() {
  for (const [id, plot] of Object.entries(plots)) {
    const width = at(id).clientWidth;
    if (width && width !== plot.width) plot.setSize({ width, height: HEIGHT });
  }
}
