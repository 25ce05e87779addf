// The page: its state, the panel beside the picture, and what happens when something is moved.
import { Robot, inverse, length, moved, plus, point, times } from "./robot.js";
import { SOLVERS, glide, look, loose, randoms, solve } from "./solve.js";
import { Renderer, seat, standing } from "./draw.js";
import { Camera, dragged, handles, under } from "./hand.js";

const FLIGHT = 350, PACE = 60, SEEN = 100, RACE = 12; // [ms] to another posture, [ms] per iteration and iterations shown, attempts
const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent), robot = new Robot(data), canvas = $("picture");
const { size, centre, floor } = data.room, camera = new Camera(canvas, centre, size);
let q = robot.home, shown = robot.fk(q), result = null, race = null, chosen = 0, held = null, motion = 0, seed = 1, renderer = null;
const random = randoms(2026); // of targets; restarts begin at seed 1, and must not start where a random target was made
let along = q.map((_, k) => Math.cos(k)); // in the null space; unlikely to be at right angles to it
const pointers = new Map(), targets = shown.tips.map((T) => ({ T, turn: robot.n >= 6 * robot.tips.length, first: false }));
const follow = (tips) => tips.forEach((T, tip) => { targets[tip].T = T; });
const apart = (a, b) => Math.max(...plus(a, b, -1).map(Math.abs));
const grip = ({ T, turn }, tip) => ({ T: times(shown.base, T), turn, size: 0.16 * robot.reach, chosen: tip === chosen });

function paint() {
  const sharp = Math.min(2, window.devicePixelRatio || 1), style = getComputedStyle(document.body);
  const color = (name) => [1, 3, 5].map((i) => parseInt(style.getPropertyValue(`--${name}`).trim().slice(i, i + 2), 16) / 255);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.round(x * sharp));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  camera.update();
  const drawn = targets.map(grip).flatMap((at, tip) => {
    const from = moved(shown.base, point(shown.tips[tip])), gap = !race && apart(point(at.T), from) > 1e-3 * size;
    const line = { shape: "bar", T: standing(from, point(at.T), 0.004 * size), color: color("bad") };
    const shades = handles(at, color(result && !result.good ? "bad" : "good"), held?.tip === tip ? held.what : null);
    return gap ? [line, ...shades] : shades;
  });
  const mine = ({ name }) => name === $("solver").value; // in a race the chosen solver's robot is solid, the others are ghosts
  const robots = (race ? [race.find(mine), ...race.filter((one) => !mine(one))] : [{ now: shown }]).map(({ name, now }, k) =>
    ({ frames: now.frames.map((T) => times(now.base, T)), color: k ? color(name) : undefined }));
  renderer.draw(camera, { back: color("sky"), line: color("grid"), dark: color("shade") }, floor, robots, drawn);
}

const UNITS = [["m", 1], ["mm", 1e-3], ["\u00b5m", 1e-6], ["nm", 1e-9]];
const metres = (x, [unit, one] = UNITS.find((other) => x >= other[1]) ?? UNITS[3]) => `${Number((x / one).toPrecision(3))} ${unit}`;
const degrees = (x) => `${((180 * x) / Math.PI).toFixed(1)}\u00b0`;
const bars = data.joints.map((joint, k) => { // a slider a joint: what fills it
  const row = $("bar").content.cloneNode(true).firstElementChild, [name, input, value] = row.children;
  const [min, max] = [Math.max(robot.lower[k], joint.low), Math.min(robot.upper[k], joint.low + joint.span)];
  Object.assign(input, { min, max, disabled: min >= max, oninput: () => play(() => show(q.with(k, Number(input.value)))) });
  name.textContent = name.title = joint.name;
  $("joints").append(row);
  return () => {
    input.value = q[k];
    value.textContent = joint.kind === "prismatic" ? `${(1e3 * q[k]).toFixed(0)} mm` : degrees(q[k]);
    row.className = Math.min(q[k] - robot.lower[k], robot.upper[k] - q[k]) < 1e-6 ? "edge" : "";
  };
});

function tell() { // curves, table and status line
  const runs = race ?? (result ? [result] : []), most = Math.min(SEEN, Math.max(1, ...runs.map((one) => one.iterations)));
  const spot = ({ error }, k) => `${40 + (k / most) * 255},${8 - 12 * Math.max(-9.5, Math.log10(error + 1e-12))}`; // a decade: 12
  for (const name of Object.keys(SOLVERS)) {
    const found = runs.find((one) => one.name === name), row = $(`row-${name}`);
    $(`curve-${name}`).setAttribute("points", (found?.history ?? []).slice(0, SEEN + 1).map(spot).join(" "));
    Object.assign(row, { hidden: !race, className: found?.good ? "good" : "bad" });
    const words = race ? [found.iterations, found.attempts, found.ms.toFixed(1), found.good ? "reached" : metres(found.history.at(-1).error)] : [];
    words.forEach((x, k) => { row.cells[k + 1].textContent = x; });
  }
  $("head").hidden = !race;
  $("most").textContent = runs.length ? `${most} iterations` : "";
  const { good, position, angle, iterations, attempt: which, attempts, ms } = result ?? {};
  $("status").className = race || !result ? "" : good ? "good" : "bad";
  $("status").textContent = race ? (race.some((one) => one.good) ? "All solvers from home, with restarts"
    : "No solver reached the target; it may be out of reach") : !result ? "Drag the target, or move a joint"
    : good && angle > 1e-3 ? `Position reached, orientation ${degrees(angle)} off: the nearest from here`
    : good ? `Reached: ${iterations} iterations${which > 1 ? ` in attempt ${which}` : ""}, ${ms.toFixed(1)} ms`
      : `Off by ${metres(position)}${angle > 1e-3 ? ` and ${degrees(angle)}` : ""}: closest pose ${attempts > 1 ? `of ${attempts} attempts` : "from here"}`;
}

// The arm at `to`, as the solve `found` left it; without one it was moved by hand, and the targets go along.
function show(to, found = null) {
  [q, result, race, shown] = [to, found, null, robot.fk(to)];
  if (!found) follow(shown.tips);
  [$("turn").checked, $("first").checked, $("first").disabled] = [targets[chosen].turn, targets[chosen].first, !targets[chosen].turn];
  $("null").disabled = !loose(robot, q, targets);
  if (!held) camera.seek([...targets.map(({ T }) => T), ...shown.tips].map((T) => moved(shown.base, point(T))));
  for (const step of [...bars, tell, paint]) step();
  return true;
}

// Call `step` with the time [ms] at every picture until it says that it has ended, or something else moves.
function play(step) {
  const mine = ++motion, start = performance.now();
  const tick = (now) => {
    if (mine !== motion) return;
    document.body.dataset.still = step(Math.max(0, now - start)) ? "1" : "";
    if (!document.body.dataset.still) requestAnimationFrame(tick);
  };
  tick(start);
}

function go(to, found) {
  const from = q, span = apart(from, to) < 0.3 ? 0 : FLIGHT;
  play((ms, t = Math.min(1, ms / span)) =>
    (t < 1 ? !show(plus(from, plus(to, from, -1), t * t * (3 - 2 * t)), found) : show(to, found)));
}

const timed = (work, start = performance.now()) => ({ ...work(), ms: performance.now() - start });
// Go to the targets: by one attempt from here while one is dragged, otherwise by as many as it takes.
function reach(options = {}) {
  const found = timed(() => solve(robot, $("solver").value, q, targets, options));
  if (options.attempts === 1) play(() => show(found.q, found));
  else if (found.good || !options.other) go(found.q, found);
  else play(() => show(q, result) && ($("status").textContent = "No other posture found"));
}

function run() { // all solvers from home, side by side, each with the restarts it takes
  if (look(robot, robot.home, targets).good) follow(robot.fk(robot.random(random)).tips);
  const runs = Object.keys(SOLVERS).map((name) => timed(() => solve(robot, name, robot.home, targets, { attempts: RACE })));
  for (const one of runs) if (one.name === $("solver").value) show(one.q, one); // where the race leaves the arm
  play((ms) => {
    const k = ms / PACE > SEEN ? Infinity : Math.floor(ms / PACE); // in the end everybody is where they got to
    race = runs.map(({ way, ...one }) =>
      ({ ...one, history: way, iterations: way.length - one.attempts - 1, now: robot.fk((way[k] ?? way.at(-1)).q) }));
    for (const step of [tell, paint]) step();
    return ms / PACE > Math.min(SEEN, Math.max(...runs.map((one) => one.way.length)));
  });
}

function slide() { // through the null space, as fast as the slider is pushed
  const push = Number($("null").value), way = (a) => a.map((x) => x * Math.sign(push));
  if (!push) return true;
  const next = glide(robot, q, targets, way(along), 0.04 * Math.abs(push));
  along = way(next.along);
  return !show(next.q, { ...look(robot, next.q, targets), history: [], iterations: 0, ms: 0 });
}

canvas.onpointerdown = ({ pointerId, offsetX, offsetY, pointerType }) => {
  canvas.setPointerCapture(pointerId);
  pointers.set(pointerId, [offsetX, offsetY]);
  held = pointers.size === 1 ? under(camera, targets.map(grip), [offsetX, offsetY], pointerType) : null;
  chosen = held?.tip ?? chosen;
  if (held) play(() => show(q, result));
};
canvas.onpointermove = ({ pointerId, offsetX, offsetY, pointerType, shiftKey }) => {
  const before = pointers.get(pointerId), now = [offsetX, offsetY], other = [...pointers].find(([id]) => id !== pointerId)?.[1];
  if (!before) { canvas.style.cursor = under(camera, targets.map(grip), now, pointerType) ? "grab" : ""; return; }
  const by = plus(now, before, -1);
  pointers.set(pointerId, now);
  if (held) {
    targets[held.tip].T = times(inverse(shown.base), dragged(camera, times(shown.base, targets[held.tip].T), held, by));
    reach({ attempts: 1 });
  } else {
    if (other) camera.zoom(length(plus(before, other, -1)) / Math.max(1, length(plus(now, other, -1))));
    if (other || shiftKey) camera.pan(by.map((x) => x / pointers.size));
    else camera.orbit(by);
    paint();
  }
};
canvas.onpointerup = canvas.onpointercancel = ({ pointerId }) => {
  const next = !held ? paint : result && !result.good ? reach : () => show(q, result);
  held = null;
  pointers.delete(pointerId);
  next();
};
canvas.onwheel = (event) => { event.preventDefault(); camera.zoom(Math.exp(0.001 * event.deltaY)); paint(); };
$("solver").onchange = () => reach();
for (const what of ["turn", "first"]) $(what).onchange = () => { targets[chosen][what] = $(what).checked; reach(); };
$("home").onclick = () => go(robot.home, null);
$("random").onclick = () => { follow(robot.fk(robot.random(random)).tips); reach(); };
$("other").onclick = () => reach({ seed: ++seed, other: (there) => apart(there, q) < 0.2 });
$("race").onclick = run;
$("null").oninput = () => document.body.dataset.still && play(slide);
$("null").onchange = $("null").onpointerup = () => { $("null").value = 0; };

// In a frame of a notebook's cell, whose script (cell/cell.js of the package) closes it off-screen and opens it again as it was.
function inCell(say) {
  addEventListener("message", ({ source, data: { open, close } }) => {
    if (source !== parent) return;
    const { state } = open ?? {};
    if (state) play(() => show(state.q) && (state.targets.forEach((was, tip) => Object.assign(targets[tip], was)), show(state.q, state.result)));
    if (open) say({ ready: 1 });
    if (!close) return;
    say({ state: { q, result, targets } });
    say({ still: canvas.toDataURL("image/jpeg", 0.9) });
    renderer.gl.getExtension("WEBGL_lose_context")?.loseContext();
  });
  say({ hello: 1 });
}

try {
  const bytes = Uint8Array.from(atob($("shapes").textContent), (c) => c.charCodeAt(0));
  const blob = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
  const [vertex, fragment] = ["vertex", "fragment"].map((name) => $(name).textContent.trim());
  renderer = new Renderer(canvas, { vertex, fragment }, data, blob);
  new ResizeObserver(paint).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").onchange = paint;
  const pixels = (p) => camera.screen(moved(shown.base, p)), state = () => ({ q, result, race, at: targets.map(({ T }) => pixels(point(T))) });
  window.arm = { robot, renderer, seat, solve, targets, state, pixels }; // for pages that embed this one
  play(() => show(q));
  if (parent !== window) inCell((ik) => parent.postMessage({ ik }, "*"));
} catch (error) {
  Object.assign($("status"), { className: "bad", textContent: error.message });
}
