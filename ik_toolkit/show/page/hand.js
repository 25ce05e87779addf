// What the pointer does: it turns the camera, or drags a target by its ball (in the picture's plane), an arrow or a ring.
import { clamp, column, cross, inverse, length, moved, placed, plus, point, rotation, times, turned, unit } from "./robot.js";
import { standing } from "./draw.js";

const AXES = [[0.86, 0.2, 0.18], [0.13, 0.62, 0.27], [0.16, 0.42, 0.88]]; // x red, y green, z blue
const NEAR = { mouse: 11, pen: 14, touch: 26 }; // [px] within which a handle is picked up
const LENS = 1 / Math.tan(Math.PI / 10), BALL = 0.13, RING = 0.72; // 36 degrees of view; as parts of an arrow's length
const FAR = 20, INSIDE = 0.45; // [sizes of the robot] the furthest camera; [width, height] from the middle that is not yet the edge
const SPINE = { // points of a shape by which it is found under the pointer
  ball: [[0, 0, 0]], cone: [[0, 0, 0], [0, 0, 0.5], [0, 0, 1]], bar: [3, 4, 5, 6, 7, 8, 9].map((z) => [0, 0, z / 10]),
  ring: Array.from({ length: 72 }, (_, k) => [Math.cos((k * Math.PI) / 36), Math.sin((k * Math.PI) / 36), 0]),
};

export class Camera {
  constructor(canvas, centre, size) {
    Object.assign(this, { canvas, centre, size, yaw: -0.75, pitch: 0.36, far: 2.1 * size });
  }

  // Placement of the eye, which looks along its -z axis, and its matrices.
  update() {
    const { yaw, pitch, far, canvas } = this, c = Math.cos(pitch), aspect = canvas.clientWidth / canvas.clientHeight;
    const back = [c * Math.cos(yaw), c * Math.sin(yaw), Math.sin(pitch)], right = [-Math.sin(yaw), Math.cos(yaw), 0];
    const up = cross(back, right), away = far * Math.max(1, 1.2 / aspect); // further away where the picture is narrow
    const near = away / 100, end = away + 30 * this.size;
    this.eye = [0, 1, 2].flatMap((r) => [right[r], up[r], back[r], this.centre[r] + away * back[r]]);
    this.view = inverse(this.eye);
    this.lens = new Float32Array([LENS / aspect, 0, 0, 0, 0, LENS, 0, 0, 0, 0, (end + near) / (near - end), -1, 0, 0,
      (2 * end * near) / (near - end), 0]);
    this.pixel = (2 * away) / (LENS * canvas.clientHeight); // [m] at the centre
  }

  screen(p) { // pixels of a point of the world
    const [x, y, z] = moved(this.view, p), { clientWidth: w, clientHeight: h } = this.canvas;
    return [(w - (LENS * x * h) / z) / 2, (h + (LENS * y * h) / z) / 2];
  }

  shift(p, [dx, dy]) { // how far the point p of the world moves when it moves by these pixels, at its depth
    const step = (-2 * moved(this.view, p)[2]) / (LENS * this.canvas.clientHeight);
    return turned(this.eye, [dx * step, -dy * step, 0]);
  }

  orbit = ([dx, dy]) => Object.assign(this, { yaw: this.yaw - 0.008 * dx, pitch: clamp(this.pitch + 0.008 * dy, -1.5, 1.5) });
  pan = (pixels) => Object.assign(this, { centre: plus(this.centre, this.shift(this.centre, pixels), -1) });
  zoom = (factor) => Object.assign(this, { far: clamp(this.far * factor, 0.2 * this.size, FAR * this.size) });
  seek(points) { // where one of these points of the world is outside the picture: aims between them, from where they are in it
    const { clientWidth: w, clientHeight: h } = this.canvas, off = ([x, y]) => Math.max(Math.abs(x / w - 0.5), Math.abs(y / h - 0.5));
    const out = () => this.update() ?? (w && h && points.some((p) => off(this.screen(p)) > INSIDE || moved(this.view, p)[2] > 0));
    if (out()) this.centre = points.reduce((sum, p) => plus(sum, p, 1 / points.length), [0, 0, 0]);
    while (out() && this.far < FAR * this.size) this.zoom(1.05);
  }
}

// What is drawn of a target ({T in the world, size, chosen, turn}): a ball and, when chosen, arrows and rings.
export function handles({ T, size, chosen, turn }, color, held) {
  const p = point(T), drawn = [{ what: "ball", shape: "ball", T: standing(p, plus(p, [0, 0, BALL * size]), BALL * size), color }];
  for (let k = 0; chosen && k < 3; k++) {
    const along = (far) => plus(p, column(T, k), far * size);
    const add = (what, shape, from, to, thick) => drawn.push({ what, shape, T: standing(from, to, thick * size), color: AXES[k] });
    add(`move${k}`, "bar", along(BALL), along(0.85), 0.022);
    add(`move${k}`, "cone", along(0.82), along(1.04), 0.07);
    if (turn) add(`turn${k}`, "ring", p, along(RING), RING);
  }
  return drawn.map((one) => ({ ...one, alpha: held && held !== one.what ? 0.2 : 0.95 }));
}

// The nearest handle of some targets under pixels `at`: {tip, what, at: its point in the world}, or null.
export function under(camera, targets, at, pointer) {
  let best = null;
  targets.forEach((target, tip) => handles(target, AXES[0], null).forEach(({ what, shape, T }) => SPINE[shape].forEach((spot) => {
    const p = moved(T, spot), wide = shape === "ball" ? (BALL * target.size) / camera.pixel : 0;
    const gap = length(plus(camera.screen(p), at, -1)) - wide;
    if (gap < (NEAR[pointer] ?? NEAR.mouse) && !(gap >= best?.gap)) best = { tip, what, at: p, gap };
  })));
  return best;
}

// T after the handle `held` was dragged by some pixels; held.at moves with it.
export function dragged(camera, T, held, pixels) {
  const p = point(T), k = Number(held.what.at(-1));
  if (held.what === "ball") return placed(T, plus(p, camera.shift(p, pixels)));
  const axis = column(T, k), slides = held.what.startsWith("move"), way = slides ? axis : cross(axis, plus(held.at, p, -1));
  const tiny = 1e-3 * camera.pixel, there = camera.screen(plus(held.at, unit(way), tiny)), far = length(way);
  const speed = plus(there, camera.screen(held.at), -1).map((x) => (x * far) / tiny); // pixels per metre or radian
  const least = (0.3 * far) / camera.pixel; // limits the speed of an arrow that points at the eye
  const amount = (pixels[0] * speed[0] + pixels[1] * speed[1]) / Math.max(speed[0] ** 2 + speed[1] ** 2, least ** 2);
  const turn = rotation(axis, slides ? 0 : amount), to = slides ? plus(p, axis, amount) : p;
  held.at = plus(to, turned(turn, plus(held.at, p, -1)));
  return placed(times(turn, T), to);
}
