// A headset: its session, its controllers, and the images on a wall ahead of the person.
import { Clutch, pressed, steering } from "./headset_motion.js";
import { Wall } from "./wall.js";

const MODES = { "enter-vr": "immersive-vr", "enter-ar": "immersive-ar" };
const MAX_FRAME_S = 0.05; // a frame that comes late moves the hand no further than this time allows
const at = (id) => document.getElementById(id);

export class Headset {
  constructor({ inputs, press, running, facts, cycle, images, lines, drives }) {
    Object.assign(this, { inputs, press, running, facts, cycle, images, lines, drives });
    this.session = null;
    this.clutch = new Clutch();
    this.held = new Map();
    for (const [id, mode] of Object.entries(MODES)) at(id).addEventListener("click", () => this.enter(mode));
    navigator.xr?.addEventListener("devicechange", () => this.offer());
    this.offer();
  }

  // -- session -------------------------------------------------------------------------------------

  async offer() {
    let found = false;
    for (const [id, mode] of Object.entries(MODES)) {
      const usable = Boolean(await navigator.xr?.isSessionSupported(mode).catch(() => false));
      at(id).hidden = !usable;
      found ||= usable;
    }
    this.describe(found ? "Headset found" : isSecureContext ? "" : "Headset, phone: over https only", found);
  }

  describe(text, on) {
    at("device-headset").hidden = !text;
    at("device-headset").textContent = text;
    at("device-headset").classList.toggle("on", on);
  }

  async enter(mode) {
    if (this.session) return;
    let session = null;
    try {
      session = await navigator.xr.requestSession(mode, { requiredFeatures: ["local-floor"] });
      session.addEventListener("end", () => this.left());
      session.addEventListener("visibilitychange", () => this.seen());
      const gl = document.createElement("canvas").getContext("webgl", { xrCompatible: true });
      this.layer = new XRWebGLLayer(session, gl);
      await session.updateRenderState({ baseLayer: this.layer });
      this.space = await session.requestReferenceSpace("local-floor");
      this.space.addEventListener("reset", () => this.clutch.drop());
      this.wall = new Wall(gl, mode === "immersive-ar");
      this.then = performance.now();
      session.requestAnimationFrame(this.frame);
      this.session = session;
      this.describe("Headset steers while the grip button is held", true);
    } catch (error) {
      await session?.end().catch(() => {});
      this.describe(`Headset: ${error.message}`, false);
    }
  }

  left() {
    if (!this.session) return; // it never began: enter() says why
    this.rest();
    this.session = null;
    this.held.clear();
    this.offer();
  }

  // The system's menu, or a headset taken off: controllers are not ours meanwhile.
  seen() {
    if (this.session?.visibilityState === "hidden") this.rest();
    else this.clutch.drop();
  }

  rest() {
    this.clutch.drop();
    this.inputs.release();
    if (this.running()) this.press("pause");
  }

  // -- a frame -------------------------------------------------------------------------------------

  frame = (now, frame) => {
    if (!this.session) return;
    this.session.requestAnimationFrame(this.frame);
    const seconds = Math.min(Math.max(now - this.then, 0) / 1000, MAX_FRAME_S);
    this.then = now;
    if (this.session.visibilityState === "visible") {
      for (const source of this.session.inputSources) this.act(source);
      this.steer(frame, seconds);
    }
    this.cycle();
    this.wall.show(frame.getViewerPose(this.space), this.layer, this.images(), this.lines());
  };

  act(source) {
    if (!source.gamepad || source.hand) return;
    const now = pressed(source.gamepad), before = this.held.get(source.handedness) ?? now;
    const fresh = (name) => now[name] && !before[name];
    if (fresh("trigger")) this.inputs.toggleGripper();
    if (fresh("lower")) this.press(this.running() ? "pause" : "start");
    if (fresh("upper")) this.press("reset");
    if (fresh("stick")) this.press(this.drives() ? "takeover" : "undo");
    this.held.set(source.handedness, now);
  }

  steer(frame, seconds) {
    const source = steering(this.session.inputSources);
    const pose = source && pressed(source.gamepad).squeeze && this.running() ? frame.getPose(source.gripSpace, this.space) : null;
    if (!pose || pose.emulatedPosition) { // not held, or seen by no camera: the hand stays where it is
      this.clutch.drop();
      return;
    }
    const { delta_m: metres = 0.05, delta_rad: radians = 0.2, control_hz: hz = 20 } = this.facts();
    const { position: p, orientation: q } = pose.transform;
    const limits = { metres: metres * hz * seconds, radians: radians * hz * seconds, scale: this.inputs.scale() };
    this.inputs.follow(this.clutch.follow({ position: [p.x, p.y, p.z], orientation: [q.x, q.y, q.z, q.w] }, limits), "webxr");
  }
}
