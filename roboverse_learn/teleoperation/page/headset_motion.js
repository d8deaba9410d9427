// Motions of a headset's controller, as numbers alone: poses come in, motions of the hand go out.
//
// WebXR's space "local-floor" is right-handed: x is right, y up, -z ahead of the person, in metres. A pose is
// { position: [x, y, z], orientation: [x, y, z, w] }. Rotation vectors are by the right-hand rule, in rad.

const JUMP_M = 0.2, JUMP_RAD = 1.0; // between two frames: no arm is as fast, so tracking was lost or the space was reset
const BUTTONS = { trigger: 0, squeeze: 1, stick: 3, lower: 4, upper: 5 }; // of the mapping "xr-standard": lower is A or X

// Turns a controller's translation (m) and rotation vector (rad) in WebXR's axes into a motion of the hand in the
// frame of the first image: [right, away, up] (m), and turns about these three axes (rad). The images hang ahead of
// the person, so ahead (-z) is away from the camera. `scale` is metres of the hand per metre of the controller;
// turns are as large as the controller's. Of a camera that looks along the world's +x (z up, x forward, y left), away is
// +x and right is -y; Inputs.world() turns the motion by the direction in which the camera really looks.
export function handMotion([x, y, z], [aboutX, aboutY, aboutZ], scale) {
  return [scale * x, -scale * z, scale * y, aboutX, -aboutZ, aboutY];
}

export function product([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz,
  ];
}

export const inverse = ([x, y, z, w]) => [-x, -y, -z, w];

// The rotation vector of a quaternion, by the shorter way round.
export function rotationVector([x, y, z, w]) {
  const sine = Math.hypot(x, y, z), sign = w < 0 ? -1 : 1;
  const factor = sine < 1e-9 ? 2 * sign : 2 * sign * Math.atan2(sine, Math.abs(w)) / sine;
  return [factor * x, factor * y, factor * z];
}

export function quaternion(vector) {
  const angle = Math.hypot(...vector), factor = angle < 1e-9 ? 0.5 : Math.sin(angle / 2) / angle;
  return [...vector.map((value) => factor * value), Math.cos(angle / 2)];
}

const minus = (a, b) => a.map((value, axis) => value - b[axis]);
const plus = (a, b) => a.map((value, axis) => value + b[axis]);

function shortened(vector, longest) {
  const length = Math.hypot(...vector);
  return length > longest ? vector.map((value) => value * longest / length) : vector;
}

// The hand follows a controller from where both were when it was grasped: letting go and grasping again moves the
// controller alone. What is faster than the hand may be is made up for later, as long as it is held.
export class Clutch {
  constructor() {
    this.drop();
  }

  drop() {
    this.start = null;
  }

  // Returns the motion (see handMotion) that a frame adds: at most `metres` of the hand and `radians`.
  follow(pose, { metres, radians, scale }) {
    if (!this.start || this.jumped(pose)) Object.assign(this, { start: pose, scale, moved: [0, 0, 0], turned: [0, 0, 0, 1] });
    this.last = pose;
    const way = minus(minus(pose.position, this.start.position), this.moved);
    const turn = product(product(pose.orientation, inverse(this.start.orientation)), inverse(this.turned));
    const move = shortened(way, metres / this.scale), about = shortened(rotationVector(turn), radians);
    this.moved = plus(this.moved, move);
    this.turned = product(quaternion(about), this.turned);
    return handMotion(move, about, this.scale);
  }

  jumped({ position, orientation }) {
    const turn = rotationVector(product(orientation, inverse(this.last.orientation)));
    return Math.hypot(...minus(position, this.last.position)) > JUMP_M || Math.hypot(...turn) > JUMP_RAD;
  }
}

// The controller that steers: the right one, or the only one. Tracked hands have no button to grasp by.
export function steering(sources) {
  const controllers = [...sources].filter((source) => source.gripSpace && source.gamepad && !source.hand);
  return controllers.find((source) => source.handedness === "right") ?? controllers[0] ?? null;
}

// Which buttons of a controller are down.
export function pressed(gamepad) {
  return Object.fromEntries(Object.entries(BUTTONS).map(([name, index]) => [name, gamepad?.buttons[index]?.pressed ?? false]));
}
