// In the page of a notebook: shows its scenes and pages in frames of their own, over the still pictures that stand in their cells.
// What several cells need (viewer, meshes) stands in one of them; cells wait for it, in whatever order they are run or scrolled to.
window.ikCells ??= (() => {
  const MOST = 8, LINGER = 700, PATIENCE = 1500; // frames at a time (browsers lose the 17th WebGL context); [ms] until one off-screen
  const assets = {}, cells = {}, boxes = []; //      is closed, and until a cell says that it lacks something
  const alive = () => boxes.filter((box) => box.frame && box.element.isConnected);
  const post = (box, message, move) => box.frame?.contentWindow?.postMessage(message, "*", move);

  function settle() {
    for (const box of boxes) {
      const { needs } = cells[box.id], lacking = needs.some((key) => !(key in assets));
      box.note.hidden = !(lacking && box.seen && performance.now() - box.since > PATIENCE);
      if (box.frame && !box.element.contains(box.frame)) box.frame = null;
      if (box.frame && !box.seen && !box.closing && performance.now() - box.since > LINGER) close(box);
      else if (!box.frame && box.seen && !box.failed && !lacking && alive().length < MOST) open(box);
    }
  }
  function open(box) {
    box.frame = Object.assign(document.createElement("iframe"), { title: "robot in 3-D" });
    box.frame.sandbox = "allow-scripts";
    box.frame.style.cssText = "position:absolute;inset:0;width:100%;height:100%;border:0;opacity:0";
    box.frame.srcdoc = assets[cells[box.id].needs[0]];
    box.element.append(box.frame);
  }
  function close(box) { // a frame that does not answer is removed all the same
    box.closing = setTimeout(() => remove(box), 1000);
    post(box, { close: true });
  }
  function remove(box, still) {
    clearTimeout(box.closing);
    if (still) box.image.src = still;
    box.frame?.remove();
    box.frame = box.closing = null;
    settle();
  }
  addEventListener("message", ({ source, data }) => {
    const box = data?.ik && boxes.find((one) => one.frame?.contentWindow === source), { ik } = data ?? {};
    if (!box) return;
    const { needs, about, blob, model } = cells[box.id], [, script, ...parts] = needs.map((key) => assets[key]);
    if (ik.hello) post(box, { open: { script, blobs: blob ? [...parts, blob] : parts, about, state: box.state } });
    if (ik.ready) {
      box.frame.style.opacity = 1;
      model?.send({ open: 1 });
    }
    if (ik.released) box.element.closest("[tabindex]")?.focus({ preventScroll: true }); // so that the notebook's keys work
    if (ik.state) box.state = ik.state;
    if (ik.still) remove(box, ik.still);
    if (ik.lost || ik.failed) {
      box.failed = Boolean(ik.failed);
      remove(box);
    }
    if (ik.drag && model) drag(box.id, ik);
  });
  function drag(id, message) { // the newest pose only, and one at a time, so that a slow solver is not left behind
    const cell = cells[id];
    cell.next = message;
    if (cell.busy && performance.now() - cell.busy < 10_000) return;
    [cell.busy, cell.next] = [performance.now(), null];
    cell.model.send(message);
  }
  const watch = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const box = boxes.find((one) => one.element === target);
      Object.assign(box, { seen: isIntersecting, since: performance.now() });
    }
    settle();
  }, { rootMargin: "150px" });
  function scan() {
    for (const element of document.querySelectorAll("[data-ik]")) {
      const id = element.dataset.ik;
      if (!(id in cells) || boxes.some((box) => box.element === element)) continue;
      const note = document.createElement("div");
      note.textContent = "The viewer of this notebook was in a cell that is gone. Restart the kernel and run this cell to turn the robot.";
      note.style.cssText = "position:absolute;left:12px;bottom:12px;padding:6px 10px;background:#fff;color:#37424f;font:13px sans-serif";
      note.hidden = true;
      element.append(note);
      boxes.push({ id, element, image: element.firstElementChild, note, since: performance.now() });
      watch.observe(element);
    }
    settle();
  }
  setInterval(scan, 400); // cells are put into the page before, while and after their scripts run, and come back on scrolling
  return {
    add(cell) { cells[cell.id] = { ...cells[cell.id], ...cell }; scan(); },
    keep(key, text) { assets[key] ??= text; },
    channel(id, model) { // from the widget beside the cell
      cells[id] = { needs: [], ...cells[id], model };
      model.on("msg:custom", ({ about, done }, buffers) => {
        const commands = buffers.map((view) => new Uint8Array(view.buffer, view.byteOffset, view.byteLength).slice());
        if (about) for (const box of boxes) if (box.id === id) post(box, { commands, about });
        if (!done) return;
        cells[id].busy = 0;
        if (cells[id].next) drag(id, cells[id].next);
      });
      for (const box of boxes) if (box.id === id && box.frame) model.send({ open: 1 });
    },
  };
})();
