// Devices: keyboard, mouse, touch, gamepad, a phone's orientation and headset.js become one motion of the hand.
//
// Motions are in the frame of the first image: right, away, up, and turns about these three axes (the right-hand
// rule). The server takes those of the world, whose z points up: world() turns one into the other.

const MOVES = {
  KeyD: [0, 1], KeyA: [0, -1], KeyW: [1, 1], KeyS: [1, -1], KeyR: [2, 1], KeyF: [2, -1],
  ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowUp: [1, 1], ArrowDown: [1, -1],
  KeyI: [3, 1], KeyK: [3, -1], KeyL: [4, -1], KeyJ: [4, 1], KeyQ: [5, 1], KeyE: [5, -1],
};
const BUTTONS = { Enter: "start", KeyP: "pause", KeyY: "reset", Delete: "discard", KeyU: "undo", Space: "takeover" };
const MODIFIERS = /^(Control|Alt|Meta)(Left|Right)$/;
const OPERATED = ["button", "summary", "input", "select"].map((kind) => `${kind}:focus-visible`).join();
const OPERATING = /^(Enter|Space|Arrow(Up|Down|Left|Right))$/;
const PADS = { "pad-move": [0, 1, 1, 1], "pad-lift": [5, -1, 2, 1], "pad-tilt": [4, -1, 3, 1] };
const DRAG_M_PER_PX = 0.0006, WHEEL_RAD_PER_PX = 0.002;
const MAX_SHIFT = [0.1, 0.1, 0.1, 0.5, 0.5, 0.5];
const DEAD_ZONE = 0.12;
const at = (id) => document.getElementById(id);
const still = () => [0, 0, 0, 0, 0, 0];

export class Inputs {
  constructor({ press, view, facts, running }) {
    Object.assign(this, { press, view, facts, running });
    this.keys = new Set();
    this.pads = new Map();
    this.shift = still();
    this.sticks = still();
    this.held = null;
    this.operated = null;
    this.device = "keyboard";
    this.closed = false;
    this.phoneOn = false;
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
    addEventListener("blur", () => this.release());
    // A control reached by keyboard has the keys that operate it. Asked as it gets the focus: the first key after a
    // click makes it :focus-visible too.
    addEventListener("focusin", ({ target }) => { this.operated = target.matches(OPERATED) ? target : null; });
    addEventListener("pointerdown", () => { this.operated = null; });
    at("gripper").addEventListener("click", (event) => { this.toggleGripper(); event.currentTarget.blur(); });
    at("speed").addEventListener("input", () => this.describeSpeed());
    for (const id of Object.keys(PADS)) this.watchPad(at(id), PADS[id]);
    this.offerPhone();
  }

  // -- what is sent --------------------------------------------------------------------------------

  moving() {
    return [...this.rate(), ...this.shift].some(Boolean);
  }

  read() {
    const shift = this.shift.map((value, entry) => Math.max(-MAX_SHIFT[entry], Math.min(MAX_SHIFT[entry], value)));
    this.shift = still();
    const round = (value) => Math.round(value * 1e5) / 1e5;
    return {
      rate: this.world(this.rate()).map(round), shift: this.world(shift).map(round),
      gripper: this.closed ? -1 : 1, device: this.device,
    };
  }

  rate() {
    const speed = Number(at("speed").value) * (this.keys.has("ShiftLeft") || this.keys.has("ShiftRight") ? 0.3 : 1);
    const sum = this.sticks.slice();
    for (const code of this.keys) if (code in MOVES) sum[MOVES[code][0]] += MOVES[code][1];
    for (const pad of this.pads.values()) for (const [entry, value] of pad) sum[entry] += value;
    return sum.map((value) => speed * Math.max(-1, Math.min(1, value)));
  }

  world([right, away, up, aboutRight, aboutAway, aboutUp]) {
    const [c, s] = [Math.cos(this.view()), Math.sin(this.view())];
    const turn = (r, a) => [c * a + s * r, s * a - c * r];
    return [...turn(right, away), up, ...turn(aboutRight, aboutAway), aboutUp];
  }

  rest(gripper) {
    this.shift = still();
    this.close(gripper < 0);
  }

  release() {
    this.keys.clear();
    this.shift = still();
    for (const id of Object.keys(PADS)) this.dropPad(at(id));
  }

  close(closed) {
    this.closed = closed;
    at("gripper").setAttribute("aria-pressed", String(closed));
    at("gripper-text").textContent = closed ? "Open gripper" : "Close gripper";
  }

  toggleGripper() {
    this.close(!this.closed);
  }

  // How far the hand moves for a motion of the person's, by the speed that is chosen: 1 as the page is opened.
  scale() {
    return Number(at("speed").value) / 0.3;
  }

  follow(motion, device) {
    motion.forEach((value, entry) => { this.shift[entry] += value; });
    if (motion.some(Boolean)) this.device = device;
  }

  describeSpeed() {
    const { delta_m: step = 0.05, control_hz: hz = 20 } = this.facts();
    at("speed-text").textContent = `${Math.round(100 * at("speed").value * step * hz)} cm/s`;
  }

  // -- keyboard ------------------------------------------------------------------------------------

  key(event, down) {
    const { code } = event;
    if (!down) { // wherever it is let go: what stays held moves the arm
      this.keys.delete(code);
      return;
    }
    if (MODIFIERS.test(code)) this.keys.clear(); // macOS tells of no key that is let go beside Command
    if (event.target.matches?.("input:not([type=range]):not([type=checkbox])") || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target === this.operated && OPERATING.test(code)) return;
    if (code in MOVES || code in BUTTONS || code === "KeyG") event.preventDefault();
    if (code in MOVES) this.device = "keyboard";
    if (event.repeat) return;
    this.keys.add(code);
    if (code === "KeyG") this.toggleGripper();
    if (code in BUTTONS) this.press(BUTTONS[code]);
  }

  // -- mouse and touch ------------------------------------------------------------------------------

  watchImage(canvas) {
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      if (event.button === 1) this.toggleGripper();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons || !this.running()) return;
      this.device = event.pointerType === "mouse" ? "mouse" : "touch";
      const scale = DRAG_M_PER_PX * this.scale();
      this.shift[0] += scale * event.movementX;
      this.shift[event.buttons & 2 ? 2 : 1] -= scale * event.movementY;
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (!this.running()) return;
      this.device = "mouse";
      this.shift[5] -= WHEEL_RAD_PER_PX * event.deltaY;
    }, { passive: false });
  }

  watchPad(pad, [across, acrossSign, along, alongSign]) {
    const steer = (event) => {
      const box = pad.getBoundingClientRect();
      const part = (value, size) => Math.max(-1, Math.min(1, 2.4 * value / size));
      const x = part(event.clientX - box.left - box.width / 2, box.width);
      const y = part(event.clientY - box.top - box.height / 2, box.height);
      const eased = (value) => Math.abs(value) < DEAD_ZONE ? 0 : value * Math.abs(value);
      this.pads.set(pad.id, [[across, acrossSign * eased(x)], [along, -alongSign * eased(y)]]);
      this.device = event.pointerType === "mouse" ? "mouse" : "touch";
      pad.querySelector(".knob").style.transform = `translate(${x * box.width * 0.36}px, ${y * box.height * 0.36}px)`;
    };
    const knob = document.createElement("i");
    knob.className = "knob";
    pad.append(knob);
    pad.addEventListener("contextmenu", (event) => event.preventDefault());
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      pad.classList.add("held");
      steer(event);
    });
    pad.addEventListener("pointermove", (event) => { if (pad.classList.contains("held")) steer(event); });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(end, () => this.dropPad(pad));
  }

  dropPad(pad) {
    this.pads.delete(pad.id);
    pad.classList.remove("held");
    pad.querySelector(".knob").style.transform = "";
  }

  // -- gamepad ---------------------------------------------------------------------------------------

  poll() {
    const pad = [...(navigator.getGamepads?.() ?? [])].find((each) => each?.connected);
    at("device-gamepad").classList.toggle("on", Boolean(pad));
    at("device-gamepad").textContent = pad ? "Gamepad connected" : "Gamepad: press a button";
    this.sticks = still();
    if (!pad) {
      this.held = null;
      return;
    }
    const axis = (index) => {
      const value = pad.axes[index] ?? 0;
      return Math.abs(value) < DEAD_ZONE ? 0 : Math.sign(value) * (Math.abs(value) - DEAD_ZONE) / (1 - DEAD_ZONE);
    };
    const down = (index) => Number(pad.buttons[index]?.pressed ?? false);
    this.sticks = [axis(0), -axis(1), -axis(3), down(12) - down(13), down(14) - down(15), -axis(2)];
    if (this.sticks.some(Boolean)) this.device = "gamepad";
    const pressed = pad.buttons.map((button) => button.pressed);
    this.held ??= pressed; // browsers show a gamepad at the press of a button, which is meant for nothing else
    const fresh = (index) => pressed[index] && !this.held[index];
    if (fresh(0)) this.toggleGripper();
    if (fresh(1)) this.press("discard");
    if (fresh(2)) this.press("reset");
    if (fresh(3)) this.press("takeover");
    if (fresh(8)) this.press("undo");
    if (fresh(9)) this.press(this.running() ? "pause" : "start");
    this.held = pressed;
  }

  // -- a phone's orientation ---------------------------------------------------------------------------

  offerPhone() {
    const usable = "DeviceOrientationEvent" in window && isSecureContext && matchMedia("(pointer: coarse)").matches;
    at("phone").hidden = !usable;
    at("phone").addEventListener("click", async () => {
      const ask = DeviceOrientationEvent.requestPermission;
      if (ask && await ask.call(DeviceOrientationEvent) !== "granted") return;
      this.phoneOn = !this.phoneOn;
      at("phone").textContent = this.phoneOn ? "Orientation steers while a pad is held" : "Use this phone's orientation";
      if (this.phoneOn) addEventListener("deviceorientation", this.oriented);
      else removeEventListener("deviceorientation", this.oriented);
    });
  }

  // The hand turns as the phone does, while a pad is held: letting go lets the wrist return.
  oriented = ({ alpha, beta, gamma }) => {
    if (alpha === null) return;
    const now = [beta, gamma, alpha].map((degrees) => degrees * Math.PI / 180);
    if (this.lastOrientation && this.pads.size && this.running()) {
      const wrap = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
      now.forEach((angle, place) => { this.shift[3 + place] += wrap(angle - this.lastOrientation[place]); });
      this.device = "phone";
    }
    this.lastOrientation = now;
  };
}
