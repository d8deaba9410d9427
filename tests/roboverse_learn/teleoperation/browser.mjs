// As much of a browser as the page needs, in Node: elements without a layout, and a headset whose frames are given.
//
// node --experimental-websocket browser.mjs <folder of the page> <its address>
// evaluates each line of its input, a JSON string, and answers with the value as a line of JSON.
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

class Target {
  listeners = {};

  addEventListener(kind, listener) {
    (this.listeners[kind] ??= []).push(listener);
  }

  async fire(kind, event = {}) {
    for (const listener of this.listeners[kind] ?? []) await listener({ currentTarget: this, target: this, ...event });
  }
}

class Element extends Target {
  textContent = "";
  hidden = false;
  value = "";
  dataset = {};
  style = {};
  children = [];
  classes = new Set();
  classList = {
    add: (name) => this.classes.add(name),
    remove: (name) => this.classes.delete(name),
    toggle: (name, on) => on ? this.classes.add(name) : this.classes.delete(name),
    contains: (name) => this.classes.has(name),
  };

  append(...children) { this.children.push(...children); }
  replaceChildren(...children) { this.children = children; }
  get firstChild() { return this.children[0] ??= new Element(); }
  querySelector() { return this.children.find((child) => child.className === "knob"); }
  setAttribute() {}
  blur() {}
  getContext(kind) { return this.context ??= recorder(kind); }
}

// A context on which every call is counted, and returns a true value, or null of a shader's wrong text.
function recorder(kind) {
  const counts = {};
  const call = (name) => (...values) => {
    counts[name] = (counts[name] ?? 0) + 1;
    (xr.calls[kind] ??= []).push([name, ...values]);
    return { name };
  };
  return new Proxy({ counts }, {
    get: (target, name) => name in target ? target[name] : name === name.toUpperCase() ? name : call(name),
    set: () => true,
  });
}

const elements = new Map();
const at = (id) => elements.get(id) ?? elements.set(id, new Element()).get(id);
const views = () => at("views").children.map((figure) => figure.children[0]);
const address = process.argv[3];
const xr = { modes: ["immersive-vr"], calls: {}, session: null, frames: [] };

class Session extends Target {
  visibilityState = "visible";
  inputSources = [];
  updateRenderState() {}
  requestReferenceSpace = async () => this.space = new Target();
  requestAnimationFrame(callback) { xr.frames.push(callback); }

  async end() {
    [xr.session, xr.frames] = [null, []];
    await this.fire("end");
  }
}

// A pose is [x, y, z, qx, qy, qz, qw] of the grip, in the space of the floor; null where it is not tracked.
xr.frame = (sources) => {
  xr.session.inputSources = sources.map(({ handedness = "right", buttons = [], pose = null, emulated = false, hand }) => ({
    handedness, hand, gamepad: { buttons: Array.from({ length: 6 }, (_, index) => ({ pressed: buttons.includes(index) })) },
    gripSpace: pose && { pose, emulated },
  }));
  const matrix = new Float32Array(16), view = { projectionMatrix: matrix, transform: { inverse: { matrix } } };
  const frame = {
    getViewerPose: () => ({ views: [view, view] }),
    getPose: ({ pose: [px, py, pz, x, y, z, w], emulated }) => (
      { emulatedPosition: emulated, transform: { position: { x: px, y: py, z: pz }, orientation: { x, y, z, w } } }),
  };
  for (const callback of xr.frames.splice(0)) callback(performance.now(), frame);
};

const page = new Target();
const outside = {
  xr, at, views, page,
  document: Object.assign(page, {
    body: new Element(), hidden: false,
    getElementById: at,
    createElement: () => new Element(),
    querySelectorAll: views,
    querySelector: (selector) => views().find((canvas) => !selector.includes("data-camera") || selector.includes(`"${canvas.dataset.camera}"`)) ?? null,
  }),
  location: new URL(address),
  sessionStorage: {}, localStorage: {},
  navigator: { xr: Object.assign(new Target(), {
    isSessionSupported: async (mode) => xr.modes.includes(mode),
    requestSession: async () => xr.session = Object.assign(new Session(), xr.broken),
  }) },
  window: {}, isSecureContext: address.startsWith("https:"),
  matchMedia: () => ({ matches: false }),
  addEventListener: () => {},
  CSS: { escape: (text) => text },
  createImageBitmap: async () => ({ width: 32, height: 32, close() {} }),
  XRWebGLLayer: class { framebuffer = {}; getViewport() { return { x: 0, y: 0, width: 8, height: 8 }; } },
};
for (const [name, value] of Object.entries(outside)) Object.defineProperty(globalThis, name, { value, configurable: true });
at("speed").value = "0.3";

await import(pathToFileURL(`${process.argv[2]}/page.js`));
for await (const line of createInterface({ input: process.stdin })) {
  console.log(JSON.stringify(await eval(JSON.parse(line)) ?? null));
}
process.exit(0);
