// Enable, compensator, jog, move.

import { parse } from "./units.js";

const at = (id) => document.getElementById(id);
const PLAIN = "pid";
const NIASA = "niasa";

/// Buttons to orders.
export function wireControls(known, order) {
  at("enable").addEventListener("click", () => order({ do: "enable" }));
  at("disable").addEventListener("click", () => order({ do: "disable" }));
  const choose = (name) => order({ do: "compensator", name }).then(() => showControls(known));
  at("niasa").addEventListener("change", () => choose(at("niasa").checked ? NIASA : PLAIN));
  at("compensator").addEventListener("change", () => choose(at("compensator").value));
  at("jog-back").addEventListener("click", () => jog(order, -1));
  at("sweep").addEventListener("click", () => move(order, at("step").value, true, 4, "2"));
  at("jog-forward").addEventListener("click", () => jog(order, 1));
  const moveTo = () => move(order, at("target").value, false, Number(at("count").value));
  at("move-to").addEventListener("click", moveTo);
  // Enter moves from the target's field only: in the others it ends typing.
  at("target").addEventListener("keydown", (event) => {
    if (event.key === "Enter" && !event.repeat && !at("move-to").disabled) moveTo();
  });
  at("move").addEventListener("submit", (event) => event.preventDefault());
  at("move-by").addEventListener("click", () => move(order, at("target").value, true, Number(at("count").value)));
}

/// A step of the jog buttons, one way or the other.
function jog(order, direction) {
  const step = at("step").value;
  return move(order, direction < 0 ? `-${step}` : step, true, 1, at("pace").value);
}

/// A little more than the slowest speed that a drive takes, m/s.
const SLOWEST_M_PER_S = 1.001e-6;

/// Reads the fields and sends the move; what cannot be read is said below them. `pace`: how long each move takes, s, if the limits
/// allow it.
function move(order, distance, relative, count, pace = "") {
  try {
    const jerk = at("jerk").value.trim();
    const to_m = parse(distance, "m");
    const limit_m_per_s = parse(at("velocity").value, "m/s");
    const action = {
      do: "move",
      to_m,
      relative,
      velocity_m_per_s: pace ? Math.min(limit_m_per_s, Math.max(SLOWEST_M_PER_S, Math.abs(to_m) / Number(pace))) : limit_m_per_s,
      acceleration_m_per_s2: parse(at("acceleration").value, "m/s²"),
      jerk_m_per_s3: jerk ? parse(jerk, "m/s³") : null,
      count: Math.max(1, Math.round(count) || 1),
      window_s: Number(at("window").value),
    };
    at("move-error").textContent = "";
    return order(action);
  } catch (error) {
    at("move-error").textContent = error.message;
    return Promise.resolve(false);
  }
}

/// What can be pressed now, and what is chosen.
export function showControls(known) {
  const status = known.status;
  const commands = document.body.dataset.role === "commands" && document.body.dataset.link === "up";
  const rests = Boolean(status?.torque && !status.moving);
  const can = {
    enable: Boolean(status && !status.torque && !status.fault),
    disable: Boolean(status?.torque),
    "jog-back": rests,
    "jog-forward": rests,
    sweep: rests,
    "move-to": rests,
    "move-by": rests,
    save: Boolean(status && !status.torque),
  };
  for (const element of document.querySelectorAll(".command")) {
    const disabled = !commands || can[element.id] === false;
    if (element.disabled !== disabled) element.disabled = disabled;
  }
  at("move-to").textContent = status?.moves_left > 1 ? `${status.moves_left} moves to go` : "Move to";
  showCompensator(known);
}

function showCompensator(known) {
  const { welcome, parameters } = known;
  if (!welcome || !parameters) return;
  const list = at("compensator");
  if (list.options.length !== welcome.compensators.length) {
    list.replaceChildren(...welcome.compensators.map((name) => new Option(name)));
  }
  const chosen = welcome.compensators[parameters.values[welcome.table.findIndex((row) => row.name === "compensator")]];
  if (document.activeElement !== list) list.value = chosen;
  at("niasa").checked = chosen === NIASA;
}
