// A scene in a frame of a notebook's page: the cell's script (cell.js) opens, feeds and closes it, and hears of a dragged target.
const tell = (ik, move) => parent.postMessage({ ik }, "*", move), NEAR = 16, TURN = 0.012; // [px], [rad/px]
let grips = [], held = null;

const plainly = show;
show = (about) => {
  plainly(about);
  if (about.drag) grips = about.drag;
  if (about.curves) chart(about.curves);
};
addEventListener("message", async ({ source, data: { open, close, commands, about } }) => {
  if (source !== parent) return;
  if (open) {
    try { await opened(open); } catch (error) { return tell({ failed: String(error) }); }
  } else if (!viewer) return;
  for (const command of commands ?? []) viewer.handle_command_bytearray(command);
  for (const words of about instanceof Array ? about : []) show(JSON.parse(words));
  raise();
  if (close) {
    viewer.render();
    const { position } = viewer.camera, { target } = viewer.controls;
    tell({ state: { position: position.toArray(), target: target.toArray(), frame, aimed } });
    tell({ still: viewer.renderer.domElement.toDataURL("image/jpeg", 0.9) });
    viewer.renderer.forceContextLoss();
  }
});
async function opened({ script, blobs, about, state }) {
  await still(script, blobs, about);
  if (state) {
    aimed = state.aimed;
    viewer.camera.position.fromArray(state.position);
    viewer.controls.target.fromArray(state.target);
    viewer.controls.update();
    if (frames) seek(state.frame);
  }
  const canvas = viewer.renderer.domElement, take = viewer.handle_command;
  canvas.addEventListener("webglcontextlost", () => tell({ lost: 1 }));
  viewer.handle_command = (c) => (held && c.type === "set_transform" && c.path === `/meshcat/${held.name}` ? null : take(c));
  for (const [name, act] of Object.entries({ pointerdown: take_hold, pointermove: pull, pointerup: let_go, pointercancel: let_go }))
    document.addEventListener(name, act, true);
  raise();
  requestAnimationFrame(() => requestAnimationFrame(() => tell({ ready: 1 })));
}

// ------------------------------------------------------------------------------------------------- targets that can be dragged
const object = (name) => viewer.scene_tree.find(["meshcat", ...name.split("/")]).object;
const vector = (x, y, z) => viewer.camera.position.clone().set(x, y, z);
function raise() { // the balls to drag are drawn over the robot, which hides them where it has reached them
  for (const { name } of grips)
    object(`${name}/0`).traverse((one) => one.material && (one.renderOrder = 1, one.material.depthTest = false));
}
function pixel(p) { // of a point of the world, with its depth
  const { clientWidth: w, clientHeight: h } = $("box"), at = p.project(viewer.camera);
  return [((at.x + 1) / 2) * w, ((1 - at.y) / 2) * h, at.z];
}
function under({ clientX, clientY }) { // the nearest handle: the ball of a target, or the end of one of its axes
  let best = null;
  for (const { name, size, turns } of grips) {
    const one = object(name);
    one.updateWorldMatrix(true, false);
    for (const axis of turns ? [-1, 0, 1, 2] : [-1]) {
      const p = one.localToWorld(vector(...[0, 1, 2].map((k) => (k === axis ? size : 0)))), [x, y, depth] = pixel(p);
      const gap = Math.hypot(x - clientX, y - clientY);
      if (gap < NEAR && gap < (best?.gap ?? Infinity)) best = { name, axis, size, gap, depth };
    }
  }
  return best;
}
function take_hold(event) {
  if (event.target !== viewer.renderer.domElement || !(held = under(event))) return;
  held.last = [event.clientX, event.clientY];
  event.stopImmediatePropagation();
  event.target.setPointerCapture(event.pointerId);
}
function pull(event) {
  if (!held) {
    viewer.renderer.domElement.style.cursor = under(event) ? "grab" : "";
    return;
  }
  event.stopImmediatePropagation();
  const one = object(held.name), { clientWidth: w, clientHeight: h } = $("box");
  const [dx, dy] = [event.clientX - held.last[0], event.clientY - held.last[1]];
  if (held.axis < 0) {
    const p = vector((2 * event.clientX) / w - 1, 1 - (2 * event.clientY) / h, held.depth).unproject(viewer.camera);
    one.position.copy(one.parent.worldToLocal(p));
  } else {
    const unit = vector(...[0, 1, 2].map((k) => Number(k === held.axis)));
    const [from, to] = [one.localToWorld(vector(0, 0, 0)), one.localToWorld(unit.clone().multiplyScalar(held.size))].map(pixel);
    const [ax, ay] = [to[0] - from[0], to[1] - from[1]], far = Math.max(ax * ax + ay * ay, 100); // limits an axis towards the eye
    if (event.shiftKey) one.rotateOnAxis(unit, TURN * ((ax * dy - ay * dx) / Math.sqrt(far)) * -1);
    else one.translateOnAxis(unit, ((ax * dx + ay * dy) / far) * held.size);
  }
  held.last = [event.clientX, event.clientY];
  one.updateMatrix();
  viewer.set_dirty();
  tell({ drag: held.name, pose: [...one.matrix.elements] });
}
function let_go(event) {
  if (held) event.stopImmediatePropagation();
  if (event.target === viewer.renderer.domElement) tell({ released: 1 });
  held = null;
}

// ------------------------------------------------------------------------------------------------- errors of solvers, as curves
function chart(curves) {
  const made = (tag, attributes, text = "") => {
    const one = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
    one.textContent = text;
    return one;
  };
  const most = Math.max(1, ...curves.flatMap(([, , errors]) => errors.map(([k]) => k)));
  const spot = ([k, x]) => `${34 + (k / most) * 256},${8 + 12 * Math.min(9, Math.max(0, -Math.log10(x + 1e-12)))}`;
  const card = made("svg", { id: "chart", width: 292, height: 146 + 16 * curves.length, class: "card", role: "img" });
  for (const [k, unit] of ["1 m", "1 mm", "1 \u00b5m", "1 nm"].entries())
    card.append(made("line", { x1: 34, x2: 290, y1: 8 + 36 * k, y2: 8 + 36 * k, stroke: "#d5dce4" }),
      made("text", { x: 0, y: 12 + 36 * k, "font-size": 10, fill: "#4a5766" }, unit));
  card.append(made("text", { x: 290, y: 130, "font-size": 10, "text-anchor": "end", fill: "#4a5766" }, `error over ${most} iterations`));
  for (const [k, [name, color, errors, words]] of curves.entries())
    card.append(made("polyline", { points: errors.map(spot).join(" "), fill: "none", stroke: color, "stroke-width": 2 }),
      made("rect", { x: 0, y: 138 + 16 * k, width: 10, height: 10, rx: 3, fill: color }),
      made("text", { x: 16, y: 147 + 16 * k, "font-size": 11, fill: "#1d2733" }, `${name}: ${words}`));
  card.style.cssText = "right:12px;top:12px;padding:9px 12px;box-sizing:content-box;pointer-events:none";
  $("chart")?.remove();
  $("box").style.right = document.body.clientWidth > 620 ? "342px" : "0"; // beside the picture, where there is room
  document.body.append(card);
}
tell({ hello: 1 });
