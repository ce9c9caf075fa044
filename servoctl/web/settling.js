// Tables of settling: moves like the last one without and with a compensator, and the last moves one by one.

import { download } from "./csv.js";
import { fixed, shortLength } from "./units.js";

const at = (id) => document.getElementById(id);
const SHOWN = 8;

/// The head of every file: where its numbers come from.
export function origin(known) {
  const drive = known.link?.drive;
  return [
    `servoctl ${drive?.servoctl ?? "?"}, firmware ${drive?.firmware ?? "?"} (program ${drive?.program ?? "?"}) on ${drive?.board ?? "?"}${drive?.is_virtual ? ", simulated" : ""}`,
    `parameters ${known.parameters?.hash ?? "?"}`,
  ];
}

/// Downloads.
export function wireMoves(known) {
  at("moves-csv").addEventListener("click", () => {
    const { last } = known.moves;
    const columns = {
      move: last.map((m) => m.number),
      distance_m: last.map((m) => m.by_m),
      compensator: last.map((m) => m.compensator),
    };
    known.welcome.tolerances_nm.forEach((nm, i) => (columns[`settling_${nm}nm_ms`] = last.map((m) => m.settling_ms[i])));
    columns.overshoot_nm = last.map((m) => m.overshoot_nm);
    columns.in_position_rms_nm = last.map((m) => m.rms_nm);
    columns.in_position_peak_to_peak_nm = last.map((m) => m.peak_to_peak_nm);
    download("moves.csv", [...origin(known), "units: m, ms from the end of the profile, nm; empty: not within 2 s"], columns);
  });
}

/// Both tables.
export function showMoves(known) {
  const { last, settling } = known.moves;
  at("moves-csv").disabled = last.length === 0;
  if (!settling || last.length === 0) return;
  const newest = last[last.length - 1];
  const counts = settling.configs.map((config) => `${config.settling_ms.length} with ${config.name}`).join(", ");
  at("statistics-caption").textContent =
    `Moves over ${shortLength(Math.abs(newest.by_m))} with the present limits and parameters: ${counts}. Time from the end of the profile.`;
  statistics(settling);
  single(known.welcome.tolerances_nm, last);
}

function table(element, head, body) {
  const row = (cells, kind) => {
    const tr = document.createElement("tr");
    tr.append(
      ...cells.map((text) => {
        const cell = document.createElement(kind);
        cell.textContent = text;
        return cell;
      }),
    );
    return tr;
  };
  const parts = ["thead", "tbody"].map((name) => document.createElement(name));
  parts[0].append(row(head, "th"));
  parts[1].append(...body.map((cells) => row(cells, "td")));
  element.replaceChildren(...parts);
  element.hidden = false;
}

function statistics({ tolerances_nm, configs, reduction_percent }) {
  const cell = (config, t) => {
    if (config.mean_ms[t] === null) return "not settled";
    const spread = config.std_ms[t] === null ? "" : ` ± ${fixed(config.std_ms[t], 1)}`;
    const missing = config.unsettled[t] ? `, ${config.unsettled[t]} not` : "";
    return `${fixed(config.mean_ms[t], 1)}${spread}${missing}`;
  };
  const both = configs.length > 1;
  const head = ["within", ...configs.map((config) => `${config.name}, ms`), ...(both ? ["reduction"] : [])];
  const body = tolerances_nm.map((nm, t) => [
    `±${nm} nm`,
    ...configs.map((config) => cell(config, t)),
    ...(both ? [reduction_percent[t] === null ? "–" : `${fixed(reduction_percent[t], 0)} %`] : []),
  ]);
  body.push(["rms, nm", ...configs.map((config) => fixed(config.in_position_rms_nm, 2)), ...(both ? [""] : [])]);
  table(at("statistics"), head, body);
}

function single(tolerances_nm, last) {
  const shown = [0, 2, tolerances_nm.length - 1];
  const head = ["move", "by", "with", ...shown.map((t) => `±${tolerances_nm[t]}, ms`), "overshoot, nm", "rms, nm", "p-p, nm"];
  const body = last
    .slice(-SHOWN)
    .reverse()
    .map((m) => [
      `${m.number}`,
      shortLength(m.by_m),
      m.compensator,
      ...shown.map((t) => fixed(m.settling_ms[t], 1)),
      fixed(m.overshoot_nm, 1),
      fixed(m.rms_nm, 2),
      fixed(m.peak_to_peak_nm, 1),
    ]);
  table(at("moves"), head, body);
}
