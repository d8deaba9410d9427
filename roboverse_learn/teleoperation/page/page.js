// The page: connection, images, status and buttons. What moves the hand is in inputs.js and headset.js.
import { Headset } from "./headset.js";
import { Inputs } from "./inputs.js";

const SEND_MS = 33;
const HEARTBEAT_MS = 250;
const RETRY_MS = [500, 1000, 2000, 4000];
const OPENED_AGAIN = 4001; // the server's code for a page that another one with the same client displaces

const at = (id) => document.getElementById(id);
const client = sessionStorage.client ??= [...crypto.getRandomValues(new Uint8Array(12))]
  .map((byte) => byte.toString(16).padStart(2, "0")).join("");

let socket = null, retries = 0, sequence = 0, seenFrame = 0, sentAt = 0, polledAt = 0, lastSent = "";
let facts = {}, status = {}, known = "";
const sendTimes = new Map(), frameTimes = [], delays = [];
const running = () => status.phase === "running" && socket?.readyState === WebSocket.OPEN;
const inputs = new Inputs({ press, view: () => status.view_yaw ?? 0, facts: () => facts, running });
const headset = new Headset({
  inputs, press, running, cycle, facts: () => facts, drives: () => Boolean(status.driver),
  images: () => [...document.querySelectorAll("#views canvas")],
  lines: () => [["phase", "clock", "light", "progress"].map((id) => at(id).textContent).join(" · "), at("note").textContent],
});

at("operator").value = localStorage.operator ?? "";
at("operator").addEventListener("change", (event) => {
  event.currentTarget.blur();
  localStorage.operator = at("operator").value.trim();
  socket?.close(1000, "new name");
});

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function press(button) {
  send({ type: "press", button });
}

// -- connection ------------------------------------------------------------------------------------

function connect() {
  const address = new URL("ws", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    seenFrame = 0;
    send({ type: "join", client, operator: at("operator").value.trim() });
  };
  socket.onmessage = ({ data }) => typeof data === "string" ? received(JSON.parse(data)) : shown(data);
  socket.onclose = ({ code, reason }) => {
    if (code === OPENED_AGAIN) { // a copy of this tab: connecting again would displace that one, which would come back
      show("connecting", "This page was opened again elsewhere.");
      return;
    }
    const over = status.phase === "over" && code === 1001;
    show("connecting", over ? "Finished. The dataset is being rendered; this page can be closed." : `Not connected${reason ? `: ${reason}` : ""}`);
    if (!over) setTimeout(connect, RETRY_MS[Math.min(retries++, RETRY_MS.length - 1)]);
  };
}

function received(message) {
  if (message.type === "hello") {
    retries = 0;
    facts = message;
    at("task").textContent = message.task;
    document.title = `${message.task} · teleoperation`;
    inputs.describeSpeed();
  } else if (message.type === "status") {
    const fresh = message.episode !== status.episode || message.acting !== status.acting || message.step < status.step
      || (message.phase === "ready" && status.phase !== "ready");
    status = message;
    if (fresh) inputs.rest(message.hand.gripper);
    drawStatus();
  } else if (message.type === "episodes") {
    drawRows(message.rows);
  } else if (message.type === "full") {
    show("connecting", `All ${message.operators} environments are taken.`);
  }
}

// -- images ----------------------------------------------------------------------------------------

async function shown(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  let start = 4 + size;
  const images = await Promise.all(Object.entries(header.images).map(([camera, length]) => {
    const jpeg = new Blob([new Uint8Array(buffer, start, length)], { type: "image/jpeg" });
    start += length;
    return createImageBitmap(jpeg).then((image) => [camera, image]);
  }));
  if (header.frame < seenFrame) return;
  seenFrame = header.frame;
  for (const [camera, image] of images) {
    const canvas = canvasOf(camera);
    if (canvas) {
      canvas.width = image.width;
      canvas.height = image.height;
      canvas.getContext("2d").drawImage(image, 0, 0);
    }
    image.close();
  }
  measure(header.seq);
  transmit(true);
}

function canvasOf(camera) {
  return document.querySelector(`canvas[data-camera="${CSS.escape(camera)}"]`);
}

function arrange(cameras) {
  const wanted = cameras.join();
  if (wanted === known) return;
  known = wanted;
  at("views").replaceChildren(...cameras.map((camera, place) => {
    const figure = document.createElement("figure"), canvas = document.createElement("canvas"), name = document.createElement("figcaption");
    canvas.dataset.camera = name.textContent = camera;
    canvas.width = canvas.height = 256;
    canvas.setAttribute("aria-label", `Image of camera ${camera}`);
    if (place === 0) inputs.watchImage(canvas);
    figure.append(canvas, name);
    return figure;
  }));
  at("cameras").replaceChildren(...(facts.cameras ?? []).map((camera) => {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = cameras.includes(camera);
    box.addEventListener("change", () => {
      const chosen = facts.cameras.filter((name) => name === camera ? box.checked : status.cameras.includes(name));
      if (chosen.length) send({ type: "view", cameras: chosen });
      else box.checked = true;
    });
    label.append(box, camera);
    return label;
  }));
}

function measure(seq) {
  const now = performance.now(), sent = sendTimes.get(seq);
  frameTimes.push(now);
  while (frameTimes.length && now - frameTimes[0] > 2000) frameTimes.shift();
  if (sent !== undefined && status.phase === "running") {
    delays.push(now - sent);
    if (delays.length > 40) delays.shift();
  }
  for (const old of sendTimes.keys()) if (old <= seq) sendTimes.delete(old);
  const delay = [...delays].sort((a, b) => a - b)[delays.length >> 1];
  at("rates").textContent = `${Math.round(frameTimes.length / 2)} images/s${delay ? ` · ${Math.round(delay)} ms` : ""}`;
}

// -- motions ---------------------------------------------------------------------------------------

function transmit(early = false) {
  const now = performance.now(), moving = inputs.moving();
  if (!socket || socket.readyState !== WebSocket.OPEN || !facts.task) return;
  if (early && now - sentAt < 8) return;
  const move = inputs.read();
  const text = JSON.stringify([move.rate, move.shift, move.gripper]);
  if (!early && !moving && text === lastSent && now - sentAt < HEARTBEAT_MS) return;
  lastSent = text;
  sentAt = now;
  sequence += 1;
  sendTimes.set(sequence, now);
  send({ type: "move", seq: sequence, ...move, seen: seenFrame });
}
// A headset's frames call it too: browsers slow down the timers of a page that is not looked at.
function cycle() {
  const now = performance.now();
  if (now - polledAt < 0.8 * SEND_MS) return;
  polledAt = now;
  inputs.poll();
  transmit();
}
setInterval(cycle, SEND_MS);
document.addEventListener("visibilitychange", () => {
  if (!document.hidden || headset.session) return;
  inputs.release();
  press("pause");
});

// -- status ----------------------------------------------------------------------------------------

const PHASES = { ready: "ready", running: "recording", paused: "paused", over: "done", connecting: "connecting" };

function show(phase, note) {
  document.body.dataset.phase = phase;
  at("phase").textContent = PHASES[phase] + (phase === "running" && status.acting === "policy" ? " · policy acts" : "");
  at("note").textContent = note;
}

function drawStatus() {
  arrange(status.cameras);
  const hints = {
    ready: "Press start; time begins with the first motion.",
    running: status.step ? "" : "Move: time begins with the first motion.",
    over: "All episodes are made. Finish renders the dataset, undo takes the last one back.",
  };
  show(status.phase, [status.note, hints[status.phase]].filter(Boolean).join(" "));
  at("instruction").textContent = status.instruction;
  at("light").textContent = status.success ? "solved" : "not solved";
  at("light").classList.toggle("on", status.success);
  document.querySelector("#views canvas")?.classList.toggle("solved", status.success);
  at("clock").textContent = `${status.seconds.toFixed(1)} s of ${status.limit_s} s`;
  at("progress").textContent = `${status.kept} of ${status.wanted} episodes`;
  at("bar").style.width = `${Math.min(100, 100 * status.seconds / status.limit_s)}%`;
  const running = status.phase === "running", begun = status.step > 0;
  at("start").disabled = running || status.phase === "over";
  at("start").firstChild.textContent = status.phase === "paused" ? "Continue " : "Start ";
  at("pause").disabled = !running;
  at("finish").disabled = !(begun || status.phase === "over");
  at("reset").disabled = !begun;
  at("discard").disabled = status.phase === "over";
  at("takeover").hidden = !status.driver;
  at("takeover").firstChild.textContent = status.acting === "policy" ? "Take over " : "Hand back ";
}

function drawRows(rows) {
  const cells = (row) => [row.index, row.mark, row.device, row.seconds.toFixed(1), `${row.path_m.toFixed(2)} m`, `${Math.round(100 * row.idle_share)} %`];
  const lines = rows.toReversed().map((row) => {
    const line = document.createElement("tr");
    line.className = row.mark;
    line.append(...cells(row).map((text, place) => {
      const cell = document.createElement("td");
      cell.textContent = text;
      cell.className = place === 1 ? row.mark : place > 2 ? "number" : "";
      return cell;
    }));
    return line;
  });
  if (!lines.length) {
    const line = document.createElement("tr"), cell = document.createElement("td");
    cell.colSpan = 6;
    cell.className = "empty";
    cell.textContent = "None yet.";
    line.append(cell);
    lines.push(line);
  }
  at("rows").replaceChildren(...lines);
}

for (const button of ["start", "pause", "finish", "reset", "discard", "undo", "takeover"]) {
  at(button).addEventListener("click", (event) => { press(button); event.currentTarget.blur(); });
}
at("help").open = matchMedia("(min-width: 821px)").matches;
drawRows([]);
connect();
