// Kinematics. Placements are arrays of 12 numbers, the rows of [R | p]; metres and radians throughout.
const TURN = 2 * Math.PI;
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const plus = (a, b, factor = 1) => a.map((x, k) => x + factor * b[k]);
export const length = (a) => Math.hypot(...a);
export const unit = (a) => a.map((x) => x / (length(a) || 1));
export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
export const point = (T) => [T[3], T[7], T[11]];
export const column = (T, k) => [T[k], T[4 + k], T[8 + k]];
export const turned = (T, v) => [0, 4, 8].map((r) => T[r] * v[0] + T[r + 1] * v[1] + T[r + 2] * v[2]);
export const moved = (T, p) => plus(turned(T, p), point(T));
export const placed = (T, p) => [...T.slice(0, 3), p[0], ...T.slice(4, 7), p[1], ...T.slice(8, 11), p[2]];

export function times(A, B) {
  const C = new Array(12);
  for (let r = 0; r < 12; r += 4) {
    for (let c = 0; c < 4; c++) C[r + c] = A[r] * B[c] + A[r + 1] * B[4 + c] + A[r + 2] * B[8 + c];
    C[r + 3] += A[r + 3];
  }
  return C;
}

export function inverse(A) {
  const T = [A[0], A[4], A[8], 0, A[1], A[5], A[9], 0, A[2], A[6], A[10], 0];
  return placed(T, turned(T, point(A)).map((x) => -x));
}

export function rotation([x, y, z], angle) {
  const c = Math.cos(angle), s = Math.sin(angle), t = 1 - c;
  return [t * x * x + c, t * x * y - s * z, t * x * z + s * y, 0, t * x * y + s * z, t * y * y + c, t * y * z - s * x, 0,
    t * x * z - s * y, t * y * z + s * x, t * z * z + c, 0];
}

// Rotation vector that turns A's axes into B's, by way of a quaternion: exact for small turns, well defined up to half a turn.
export function turnBetween(A, B) {
  const m = (r, c) => B[4 * r] * A[4 * c] + B[4 * r + 1] * A[4 * c + 1] + B[4 * r + 2] * A[4 * c + 2];
  const d = [m(0, 0), m(1, 1), m(2, 2)], trace = d[0] + d[1] + d[2];
  const v = [m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1)]; let w = 1 + trace;
  if (trace < 0) { // the largest component of the axis divides
    const i = d.indexOf(Math.max(...d)), j = (i + 1) % 3, k = (i + 2) % 3;
    w = v[i];
    [v[i], v[j], v[k]] = [1 + d[i] - d[j] - d[k], m(i, j) + m(j, i), m(i, k) + m(k, i)];
  }
  const s = length(v), angle = 2 * Math.atan2(s, Math.abs(w)) * (w < 0 ? -1 : 1);
  return v.map((x) => (s ? (x * angle) / s : 0));
}

// A tree of joints. nodes: parent (-1: the world), T (placement in the parent at 0), axis, ratio (to its coordinate, which mimic
// joints share), turns (whether it is revolute), joint (index of the coordinate); parents come first. base, tips: node and T.
export class Robot {
  constructor(data) {
    Object.assign(this, data, { n: data.joints.length, home: data.joints.map((joint) => joint.home) });
    this.lower = data.joints.map((joint) => joint.lower ?? -Infinity);
    this.upper = data.joints.map((joint) => joint.upper ?? Infinity);
    const above = (node) => (node < 0 ? [] : [node, ...above(this.nodes[node].parent)]), up = above(this.base.node);
    const only = (these, those, sign) => these.filter((node) => !those.includes(node)).map((node) => ({ node, sign }));
    this.paths = this.tips.map((tip) => [...only(up, above(tip.node), -1), ...only(above(tip.node), up, 1)]); // what moves a tip
  }

  // Placements in base axes of the nodes and tips at q, and of the base in the world.
  fk(q) {
    const world = [], end = ({ node, T }) => (node < 0 ? T : times(world[node], T));
    for (const { parent, T, axis, ratio, turns, joint } of this.nodes) {
      const x = ratio * q[joint], own = turns ? times(T, rotation(axis, x)) : placed(T, moved(T, axis.map((a) => a * x)));
      world.push(end({ node: parent, T: own }));
    }
    const base = end(this.base), back = inverse(base);
    return { base, frames: world.map((T) => times(back, T)), tips: this.tips.map((tip) => times(back, end(tip))) };
  }

  // Columns (n) of the Jacobian of a tip, `now` from fk: three linear rows [m], three angular ones, in base axes.
  jacobian(now, tip) {
    const J = Array.from({ length: this.n }, () => [0, 0, 0, 0, 0, 0]);
    for (const { node, sign } of this.paths[tip]) {
      const { axis, ratio, turns, joint } = this.nodes[node], w = turned(now.frames[node], axis);
      const lever = plus(point(now.tips[tip]), point(now.frames[node]), -1);
      J[joint] = plus(J[joint], turns ? [...cross(w, lever), ...w] : [...w, 0, 0, 0], sign * ratio);
    }
    return J;
  }

  inside = (q) => q.map((x, k) => clamp(x, this.lower[k], this.upper[k]));
  random = (next) => this.inside(this.joints.map(({ low, span }) => low + span * next()));
  wrapped = (q) => q.map((x, k) => (this.joints[k].kind === "continuous" ? x - TURN * Math.round(x / TURN) : x));
}
