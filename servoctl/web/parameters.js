// The table of parameters: values, ranges, units, and editing.

import { showControls } from "./controls.js";
import { plain } from "./units.js";

const at = (id) => document.getElementById(id);
const rows = new Map();
let filled = false;

/// Builds the table once its rows are known.
export function wireParameters(known, order) {
  if (filled) return;
  filled = true;
  const groups = Map.groupBy(known.welcome.table, (row) => row.group);
  for (const [title, members] of groups) {
    const details = document.createElement("details");
    details.innerHTML = "<summary></summary><div class='parameters'></div>";
    details.firstChild.textContent = title;
    details.lastChild.append(...members.map((row) => line(row, known, order)));
    at("parameters").append(details);
  }
  at("filter").addEventListener("input", filter);
  at("save").addEventListener("click", () => order({ do: "save" }));
  at("load").addEventListener("click", () => order({ do: "load" }));
}

/// One row: name and meaning, the field, unit, range.
function line(row, known, order) {
  const form = document.createElement("form");
  form.className = "parameter";
  form.innerHTML = `<label><code></code><small class="doc"></small></label>
    <span class="value"><input class="command" inputmode="decimal" spellcheck="false" autocomplete="off"><span class="unit"></span></span>
    <small class="range"></small>`;
  const input = form.querySelector("input");
  input.id = `parameter-${row.name}`;
  form.querySelector("label").htmlFor = input.id;
  form.querySelector("code").textContent = row.name;
  form.querySelector(".doc").textContent = row.doc;
  form.querySelector(".unit").textContent = row.unit;
  const access = row.always ? "" : "; bridge off";
  form.querySelector(".range").textContent = `${plain(row.min)} … ${plain(row.max)}${access}`.replaceAll("-", "−");
  form.querySelector(".range").title = `default ${plain(row.default)}`;
  const commit = () => change(row, input, known, order);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    commit();
  });
  input.addEventListener("change", commit);
  input.addEventListener("keydown", (event) => {
    if (event.key === "Escape") show(row, known);
  });
  rows.set(row.name, { row, form, input });
  return form;
}

/// Checks what was typed against the row, and sends it. The drive has the last word.
function change(row, input, known, order) {
  if (input.value === input.dataset.shown) return;
  const value = input.value.trim() === "" ? NaN : Number(input.value.replace(",", ".").replace("−", "-"));
  const refuse = (reason) => {
    at("parameters-error").textContent = reason;
    input.setCustomValidity(reason);
  };
  if (!Number.isFinite(value)) return refuse(`${row.name} = “${input.value}” is no number`);
  const unit = row.unit ? ` ${row.unit}` : "";
  if (value < row.min || value > row.max) {
    return refuse(`${row.name} = ${value}${unit} is outside ${plain(row.min)} … ${plain(row.max)}${unit}`);
  }
  refuse("");
  input.dataset.shown = input.value;
  order({ do: "set", parameter: row.id, value }).then((done) => {
    if (!done) show(row, known);
  });
}

/// The value in use.
function show(row, known) {
  const { form, input } = rows.get(row.name);
  const value = known.parameters.values[known.welcome.table.indexOf(row)];
  input.value = plain(value);
  input.dataset.shown = input.value;
  input.setCustomValidity("");
  form.classList.toggle("changed", value !== row.default);
}

/// All values, as the drive has them.
export function showParameters(known) {
  if (!known.welcome || !known.parameters) return;
  for (const row of known.welcome.table) {
    const { input } = rows.get(row.name);
    // What somebody is typing stays.
    if (document.activeElement !== input || input.value === input.dataset.shown) show(row, known);
  }
  at("unsaved").hidden = !known.parameters.unsaved;
  showControls(known);
}

function filter() {
  const words = at("filter").value.trim().toLowerCase();
  for (const { row, form } of rows.values()) {
    form.hidden = words !== "" && !`${row.name} ${row.doc}`.toLowerCase().includes(words);
  }
  for (const group of document.querySelectorAll("#parameters details")) {
    const some = [...group.querySelectorAll("form")].some((form) => !form.hidden);
    group.hidden = !some;
    group.open = words !== "" && some;
  }
}
