// Five iterative solvers over one view of the error, attempts from other starts, and motion inside the null space.
import { length, plus, point, turnBetween } from "./robot.js";

const TOLERANCE = 1e-6, RADIAN = 1, SECOND = 1e-3; // [m] and [rad]; the reaches that weigh as much as a radian, alone and after the position
const PRIME = 2147483647, ATTEMPTS = 100, LOOKS = 20000, DRAWN = 12; // most of each in all; random starts drawn, of which the nearest is used
const weight = ({ first }) => (first ? SECOND : RADIAN);
const inner = (a, b) => a.reduce((sum, x, k) => sum + x * b[k], 0);

// Numbers in 0..1, the same for the same seed (Park and Miller 1988, with the multiplier of 1993).
export const randoms = (seed, state = { x: 1 + (seed % (PRIME - 1)) }) => () => (state.x = (48271 * state.x) % PRIME) / PRIME;

// The arm at q against targets (by tip: null, or T, turn, whether the orientation counts, and first, whether the position comes
// before it): e, with lengths over the reach, and the largest errors [m], [rad].
export function look(robot, q, targets) {
  const now = { q, e: [], position: 0, angle: 0, held: 0, ...robot.fk(q) };
  targets.forEach((target, tip) => {
    if (!target) return;
    const gap = plus(point(target.T), point(now.tips[tip]), -1), turn = target.turn ? turnBetween(now.tips[tip], target.T) : [];
    now.e.push(...gap.map((x) => x / robot.reach), ...turn.map((x) => x * weight(target)));
    now.position = Math.max(now.position, length(gap));
    [now.angle, now.held] = [Math.max(now.angle, length(turn)), target.first ? now.held : Math.max(now.held, length(turn))];
  });
  return Object.assign(now, { ee: inner(now.e, now.e), good: now.position <= TOLERANCE && now.held <= TOLERANCE });
}

// Columns of the stacked Jacobian in the units of e.
function columns(robot, now, targets) {
  const J = robot.joints.map(() => []);
  targets.forEach((target, tip) => target && robot.jacobian(now, tip).forEach((six, k) => {
    J[k].push(...six.slice(0, target.turn ? 6 : 3).map((x, r) => (r < 3 ? x / robot.reach : x * weight(target))));
  }));
  return J;
}

// Solves (A + mu I) x = b, where A and b are the inner products of some columns with each other and with e; no pivoting needed.
function normal(J, some, mu, e) {
  const A = some.map((k, i) => [...some.map((c, j) => inner(J[k], J[c]) + (i === j ? mu : 0)), inner(J[k], e)]);
  A.forEach((row, i) => A.forEach((other, k) => { if (k !== i) A[k] = plus(other, row, -other[i] / row[i]); }));
  return A.map((row, i) => row.at(-1) / row[i]);
}

// Damped least-squares step; a joint that would pass a limit stops there, and the others make up for it.
function damped(robot, q, J, e, mu) {
  const dq = q.map(() => 0);
  let some = [...q.keys()], rest = e, out = some;
  while (some.length && out.length) {
    normal(J, some, mu, rest).forEach((x, i) => { dq[some[i]] = x; });
    out = some.filter((k) => q[k] + dq[k] < robot.lower[k] || q[k] + dq[k] > robot.upper[k]);
    for (const k of out) {
      dq[k] = (dq[k] < 0 ? robot.lower[k] : robot.upper[k]) - q[k];
      rest = plus(rest, J[k], -dq[k]);
    }
    some = some.filter((k) => !out.includes(k));
  }
  return dq;
}

// A rule takes the arm to the next iterate, or returns null when it cannot move; `see` evaluates the arm at another q.
function lm(robot, now, see, J, memory) {
  memory.mu ??= 1e-3;
  for (let grow = 2; grow < 1e6; grow *= 2) {
    const dq = damped(robot, now.q, J, now.e, memory.mu), next = see(plus(now.q, dq));
    const linear = dq.reduce((e, x, k) => plus(e, J[k], -x), now.e), predicted = now.ee - inner(linear, linear);
    if (!(predicted > 1e-30)) return null;
    const gain = (now.ee - next.ee) / predicted; // the gain ratio sets the damping (Nielsen 1999)
    memory.mu = Math.max(1e-13, memory.mu * (gain > 1e-3 ? Math.max(0.1, 1 - (2 * gain - 1) ** 3) : grow));
    if (gain > 1e-3) return next;
  }
  return null;
}
function dls(robot, now, see, J) {
  const dq = damped(robot, now.q, J, now.e, 0.03 ** 2);
  return see(plus(now.q, dq, Math.min(1, 0.5 / Math.max(...dq.map(Math.abs))))); // half a radian at most
}

function transpose(robot, now, see, J) {
  const g = J.map((one) => inner(one, now.e)), back = g.reduce((sum, x, k) => plus(sum, J[k], x), now.e.map(() => 0));
  return see(plus(now.q, g, inner(g, g) / (inner(back, back) || 1))); // the exact step along g
}

function sweep(robot, start, see, steps) { // joint by joint from the tip, each moved to where the error is least
  let now = start;
  for (let k = robot.n - 1; k >= 0 && !now.good; k--) {
    for (const step of steps(now, k)) {
      const next = see(now.q.with(k, now.q[k] + step));
      if (next.ee < now.ee) now = next;
    }
  }
  return now === start ? null : now;
}

const ccd = (robot, start, see, _, { targets }) => sweep(robot, start, see, (now, k) => {
  const one = columns(robot, now, targets)[k], size = inner(one, one);
  return size > 1e-14 ? [inner(one, now.e) / size] : [];
});

const pid = (robot, start, see, _, memory) => sweep(robot, start, see, (now, k) => { // the sign by trial, the size from a PID law
  const norm = Math.sqrt(now.ee), size = 0.25 * norm + 0.75 * (norm - (memory.norm ?? norm));
  memory.norm = norm;
  return [1, -1].map((sign) => sign * size * (robot.joints[k].kind === "prismatic" ? robot.reach : 1));
});

// Rules by name, with the iterations of an attempt.
export const SOLVERS = { lm: [lm, 80], dls: [dls, 150], transpose: [transpose, 400], ccd: [ccd, 300], pid: [pid, 300] };

// One attempt from q0: the best iterate, with `history` (q and error, lengths in m, one row per iterate) and the evaluations made.
export function attempt(robot, name, q0, targets) {
  const [rule, most] = SOLVERS[name], memory = { targets }, history = [];
  let looks = 0, best = null, still = 0;
  const see = (q) => ++looks && look(robot, robot.inside(q), targets);
  for (let now = see(q0); now; now = rule(robot, now, see, columns(robot, now, targets), memory)) {
    history.push({ q: now.q, error: Math.sqrt(now.ee) * robot.reach });
    still = now.ee < (best?.ee ?? Infinity) * (1 - 1e-6) ? 0 : still + 1; // some rules may go up for a while
    if (!best || now.ee < best.ee) best = now;
    if ((best.good && best.angle <= TOLERANCE) || still > 20 || history.length > most) break;
  }
  return { ...best, name, history, looks, iterations: history.length - 1 };
}

// Attempts from q0, then from random starts, until one succeeds: the best, its number, how many were made, and the way to it.
// other(q): skip answers for which it is true, and start elsewhere.
export function solve(robot, name, q0, targets, { attempts = ATTEMPTS, seed = 1, other = null } = {}) {
  const goals = targets.map((target) => target && { ...target, T: [target.T].flat(2) });
  const bad = goals.some((goal) => goal && !(goal.T.length === 12 && goal.T.every(Number.isFinite)));
  if (bad) throw new TypeError("T must be the first three rows of a pose, nested or as 12 finite numbers");
  const next = randoms(seed), begin = () => Array.from({ length: DRAWN }, () => look(robot, robot.random(next), goals)), way = [];
  let best = null, made = 0;
  for (let looks = 0; made < attempts && looks < LOOKS && !best?.good; looks += DRAWN) {
    const start = made || other ? begin().reduce((a, b) => (b.ee < a.ee ? b : a)).q : q0;
    const found = attempt(robot, name, start, goals);
    Object.assign(found, { q: robot.wrapped(found.q), attempt: ++made });
    looks += found.looks;
    way.push(...found.history);
    if (!(found.good && other?.(found.q)) && (found.good || !best || found.ee < best.ee)) best = found;
  }
  return best && { ...best, attempts: made, way: [...way, { q: best.q, error: Math.sqrt(best.ee) * robot.reach }] };
}

// What of a joint motion `along` (n) moves no tip.
function freed(robot, q, targets, along) {
  const J = columns(robot, look(robot, q, targets), targets), lost = along.reduce((sum, x, k) => plus(sum, J[k], x), J[0].map(() => 0));
  return plus(along, normal(J, [...q.keys()], 1e-10, lost), -1);
}
// Whether joints can move with the tips held: by the rank of the Jacobian, whose rows may be zero or depend on each other.
export const loose = (robot, q, targets) => q.some((_, j) => length(freed(robot, q, targets, q.map((__, k) => Number(k === j)))) > 1e-3);

// A step of `size` in the null space, in the direction nearest `along` (n), with the tips held. Gives q and the direction.
export function glide(robot, q, targets, along, size) {
  const free = freed(robot, q, targets, along), far = length(free);
  const there = far > 1e-3 ? attempt(robot, "lm", plus(q, free, size / far), targets) : null;
  return there?.good ? { q: there.q, along: free.map((x) => x / far) } : { q, along };
}
