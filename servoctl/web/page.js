// The page: takes messages in, and hands them to whoever shows them.

import { connect, send } from "./connection.js";
import { showControls, wireControls } from "./controls.js";
import { showParameters, wireParameters } from "./parameters.js";
import { showMoves, wireMoves } from "./settling.js";
import { addCapture, addLive, wireTraces } from "./traces.js";
import { fixed, length } from "./units.js";

const at = (id) => document.getElementById(id);

/// What is known; the parts are the last message of each kind.
const known = { welcome: null, role: null, link: null, parameters: null, status: null, moves: null };

/// Shows something that went wrong or happened, until it is dismissed or something newer comes.
export function notice(text) {
  at("notice").hidden = !text;
  at("notice").querySelector("p").textContent = sentence(text);
}

/// Sends what is wanted and shows a refusal.
export function order(action) {
  return send(action).then(
    () => true,
    (error) => {
      notice(error.message);
      return false;
    },
  );
}

const showers = {
  welcome() {
    wireParameters(known, order);
  },
  role: showRole,
  link: showLink,
  parameters() {
    showParameters(known);
    showControls(known);
  },
  status() {
    showStatus(known.status);
    showControls(known);
  },
  live(message) {
    addLive(message);
  },
  capture(message) {
    addCapture(message);
  },
  moves() {
    showMoves(known);
  },
  notice(message) {
    notice(message.text);
  },
  dropped(message) {
    at("dropped").textContent = `${message.messages} messages dropped: this browser is too slow`;
  },
};

function heard(message) {
  if (message.kind in known) known[message.kind] = message;
  showers[message.kind]?.(message);
}

function broken(reason) {
  known.link = { drive: null, trouble: reason };
  showLink();
}

function showRole() {
  const { commander, pages } = known.role;
  const mine = commander === known.welcome.page;
  document.body.dataset.role = mine ? "commands" : "looks-on";
  at("role").hidden = mine;
  at("role").querySelector("p").textContent =
    `Page ${commander} commands, this is page ${known.welcome.page} of ${pages}: it looks on. Stop works here too.`;
  showControls(known);
}

function showLink() {
  const { drive, trouble } = known.link;
  document.body.dataset.link = drive ? "up" : "down";
  at("link-trouble").hidden = !trouble;
  at("link-trouble").querySelector("p").textContent = sentence(trouble);
  if (drive) {
    at("board").textContent = drive.board;
    at("firmware").textContent = `firmware ${drive.firmware}`;
    at("simulated").hidden = !drive.is_virtual;
    at("firmware").title = `serial ${drive.serial}, program ${drive.program}, protocol ${drive.protocol}`;
  } else {
    at("state").textContent = "not connected";
    at("state").dataset.look = "down";
  }
  showControls(known);
}

function showStatus(status) {
  at("state").textContent = status.state + (status.moving ? ", moving" : "");
  at("state").dataset.look = status.fault ? "fault" : status.torque ? "on" : "off";
  at("position").textContent = `${fixed(status.position_m * 1e3, 6)} mm`;
  at("error").textContent = status.torque ? length(status.error_m) : "–";
  at("force").textContent = `${fixed(status.force_n, 3)} N`;
  at("bus").textContent = `${fixed(status.bus_v, 1)} V`;
  at("counters").textContent = [
    `longest tick ${status.longest_tick_cycles} cycles`,
    `overruns ${status.overruns}`,
    `bad encoder frames ${status.bad_frames}`,
    `lost records ${status.lost_records}`,
    `lost live samples ${status.lost_samples}`,
    `bad requests ${status.bad_requests}`,
    `repeated requests ${status.repeated_requests}`,
    `unreadable replies ${status.unreadable_replies}`,
  ].join(" · ");
  showFault(status.fault);
}

function showFault(fault) {
  const box = at("fault");
  box.hidden = !fault;
  if (!fault) return;
  box.querySelector("h2").textContent = `Fault ${fault.number}: ${fault.title}`;
  box.querySelector("h2").title = `CiA 402 error code 0x${fault.cia402_code.toString(16).padStart(4, "0")}`;
  box.querySelector(".what").textContent = sentence(fault.cause);
  box.querySelector(".advice").textContent = sentence(fault.advice);
}

/// Begins with a capital and ends with a full stop.
const sentence = (text) => (text ? `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}` : "");

/// Space brakes, wherever the focus is.
function wireStop() {
  const stop = () => order({ do: "stop" });
  at("stop").addEventListener("click", stop);
  for (const kind of ["keydown", "keyup"]) {
    addEventListener(
      kind,
      (event) => {
        if (event.code !== "Space") return;
        // Neither a blank in a field nor a click on the button that has the focus.
        event.preventDefault();
        event.stopPropagation();
        if (kind === "keydown" && !event.repeat) stop();
      },
      { capture: true },
    );
  }
}

wireStop();
wireControls(known, order);
wireTraces(known);
wireMoves(known);
at("take-over").addEventListener("click", () => order({ do: "take_over" }));
at("clear-fault").addEventListener("click", () => order({ do: "clear_fault" }));
at("dismiss").addEventListener("click", () => notice(""));
connect(heard, broken);
