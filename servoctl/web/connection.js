// The line to the server: one WebSocket, every message with the token of this page.

const PATIENCE_MS = 15000;
const RETRY_MS = 1000;

/// The token stands in the address once; then it is kept for reloads of this tab and taken out of sight.
function token() {
  if (location.hash.length > 1) {
    sessionStorage.setItem("token", location.hash.slice(1));
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token") ?? "";
}

const TOKEN = token();
let socket = null;
let lastId = 0;
const waiting = new Map();

/// Connects, again whenever the line breaks. `heard` gets every message but answers, `broken` why there is no line.
export function connect(heard, broken) {
  socket = new WebSocket(`ws://${location.host}/ws`);
  socket.onopen = () => send({ do: "hello" }).catch(() => {});
  socket.onmessage = (event) => {
    const message = JSON.parse(event.data);
    if (message.kind === "answer") settle(message);
    else heard(message);
  };
  socket.onclose = (event) => {
    for (const { refuse } of waiting.values()) refuse(new Error("the line to servoctl broke"));
    waiting.clear();
    broken(event.reason || "servoctl does not answer: has it ended?");
    // 1008: the server does not want this page; asking again would not help.
    if (event.code !== 1008) setTimeout(() => connect(heard, broken), RETRY_MS);
  };
}

function settle(answer) {
  const order = waiting.get(answer.id);
  if (!order) return;
  waiting.delete(answer.id);
  clearTimeout(order.timer);
  if (answer.error === null) order.done();
  else order.refuse(new Error(answer.error));
}

/// Sends what is wanted; the promise ends when it is done, or fails with the reason.
export function send(action) {
  return new Promise((done, refuse) => {
    if (socket?.readyState !== WebSocket.OPEN) return refuse(new Error("no line to servoctl"));
    const id = ++lastId;
    const timer = setTimeout(() => {
      waiting.delete(id);
      refuse(new Error("no answer: whether it was done is not known"));
    }, PATIENCE_MS);
    waiting.set(id, { done, refuse, timer });
    socket.send(JSON.stringify({ token: TOKEN, id, action }));
  });
}
