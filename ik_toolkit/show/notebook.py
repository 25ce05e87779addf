"""Scenes and pages in the cells of a notebook: a still picture everywhere, the scene itself where its script may run.

Parts that cells share (the viewer, the page around it, the meshes of a robot) are written once per notebook, into the first cell
that needs them; the script of every cell (cell/cell.js) waits for them. A live scene also has a `Channel` to the kernel.
"""

import base64
import copy
import functools
import hashlib
import html
import importlib.resources
import json
import re
import sys
import threading
import time
import uuid
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InvalidOption, MissingExtra
from .animation import numbered
from .body import DrawnShape
from .feed import Feed, as_json, command_bytes
from .live_page import thin
from .meshcat_server import Window, compressed, framed, viewer_script
from .picture import picture, shapes_of
from .scene_state import SceneState

# for each text that several cells share (viewer script, meshes of a robot): the cell of the notebook that contains it
_standing: dict[str, Any] = {}


class InCell(SceneState):
    """A scene that notebook cells can display; it moves there when it changes, and tells the kernel about dragged targets."""

    channel: "Channel | None" = None

    def on_drag(self, call: Callable[[Any], Any]) -> None:
        """Make the targets of a live scene draggable in its notebook cells; `call` is called with the new targets.

        The new target is a pose (4, 4) or a position (3,) [m] in the base frame, for several tips a dict of these by tip. Drag
        the ball in the plane of the picture, the end of an arrow along it, and with the shift key the end of an arrow to turn the
        target.
        """
        if not callable(call):
            raise InvalidOption(f"on_drag takes a function of the new target, not {call!r:.60}")
        self._call = call
        drawn = [numbered("target", k) for k in range(len(self.robot.tips))]
        shapes, grips = shapes_of(self.window), []
        for name in [name for name in drawn if f"{name}/0" in self.window.objects]:
            parts = [one.vertices for path, one in shapes.items() if path.startswith(f"{name}/")]
            size = max(float(np.abs(part).max()) for part in parts)
            grips.append({"name": name, "size": size, "turns": len(parts) > 1, "color": shapes[f"{name}/0"].color})
        if not grips:
            raise InvalidOption("there is no target to drag: show the scene with target=")
        self.window.say(drag=grips)

    def _dragged(self, name: str, T_world: np.ndarray) -> None:
        """Take the pose to which a page has dragged a target."""
        grips = {grip["name"]: grip["turns"] for grip in self.window.about.get("drag", [])}
        if name not in grips or not np.isfinite(T_world).all():
            return
        self.window.place(name, T_world)
        back, targets = np.linalg.inv(self.body.T_world_base), {}
        for k, tip in enumerate(self.robot.tips):
            if (one := numbered("target", k)) in grips:
                T = back @ self.window.transforms[one]
                targets[tip] = T if grips[one] else T[:3, 3]
        try:
            self._call(self.robot.for_tips(targets))
        # The user's function runs in a callback, where an error would go unseen, so the cell shows it.
        except Exception as error:
            self.say(f"{type(error).__name__}: {error}")

    def connect(self) -> None:
        """Open the connection that keeps cells showing the scene up to date; if that fails, a text in the scene says why."""
        if _shell() is None:
            return
        try:
            self.channel = Channel(self.window, self._dragged)
        except MissingExtra as error:
            self.say(f"not live: {error}")

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """Return the outputs of a cell: the scene as HTML, which is kept in the saved notebook, a picture, and text."""
        window, self._inline = self._aimed(), self.channel is None
        if self.channel is not None:
            self.channel.display()
        return scene_bundle(window, repr(self), self.channel)

    def __repr__(self) -> str:
        """Describe the scene in a line."""
        return f"Scene of {self.window.about['title']}: save('scene.html') writes it as a page"


class PageInCell:
    """A live page that displays itself in the cell of a notebook, over a picture of the robot."""

    def __init__(self, page: str, window: Window) -> None:
        """Store the page, and the Window from which its still picture is drawn."""
        self.page, self.window = page, window

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """Return the outputs that a notebook cell displays: the page, a picture and text."""
        what = f"Live page of {self.window.about['title']}: page('robot.html') writes it as a file"
        return _bundle([_part(self.page)], {"id": uuid.uuid4().hex}, what, self.window, 620)


def _missing(key: str) -> bool:
    """Return whether a shared part has to be written into the cell that runs now; if so, note that this cell has it.

    A cell that runs again loses its output, so its parts must be written again. In Colab each cell is a page of its own.
    """
    shell, here = _shell(), None
    if shell is not None:
        here = shell.get_parent().get("metadata", {}).get("cellId")
        if _forget not in shell.events.callbacks["pre_run_cell"]:
            shell.events.register("pre_run_cell", _forget)
    if key in _standing and "google.colab" not in sys.modules:
        return False
    _standing[key] = here
    return True


def _forget(info: Any) -> None:
    """Forget the shared parts in the cell that is about to run, because its output is deleted."""
    for key in [key for key, cell in _standing.items() if cell is not None and cell == info.cell_id]:
        del _standing[key]


def _shell() -> Any:
    """Return the shell of a notebook's kernel, or None outside one."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return shell if hasattr(shell, "kernel") else None


def scene_bundle(window: Window, what: str, channel: "Channel | None" = None) -> dict[str, str]:
    """Return what a notebook cell displays for a scene: text/html, image/png (with matplotlib) and text/plain."""
    robots: dict[str, dict[str, Any]] = {}
    for path, drawn in window.objects.items():
        if path.count("/") > 1:  # only the pieces of a robot have paths with two slashes, ROBOT/PART/NUMBER
            robots.setdefault(path.partition("/")[0], {})[path] = drawn
    rest = window.paths.difference(*robots.values())
    with window.lock:
        blob, about = compressed(framed(window.snapshot(rest))), compressed(as_json(_short(window.about)).encode())
        if channel is not None:
            channel.shown()
    code = (importlib.resources.files("ik_toolkit.show") / "cell" / "scene.js").read_text(encoding="utf-8")
    parts = [_part(Window()._page(code)), _part(compressed(viewer_script())), *map(_meshes, robots.values())]
    told = {"id": channel.id if channel else uuid.uuid4().hex, "blob": blob, "about": about}
    return _bundle(parts, told, what, window)


def _bundle(
    parts: list[tuple[str, str]], told: dict[str, Any], what: str, window: Window, height: int = 460
) -> dict[str, str]:
    """Return the outputs of a cell: a still picture, over which a script puts a frame (iframe) with the first of the parts."""
    try:
        png = {"image/png": base64.b64encode(picture(window)).decode()}
    except MissingExtra:  # matplotlib is missing, which the scene itself does not need
        png = {}
    told["needs"] = [key for key, _ in parts]
    calls = [f"ikCells.keep({_literal(key)}, {_literal(text)});" for key, text in parts if _missing(key)]
    place = "position:absolute;width:100%;height:100%;object-fit:contain"
    source = f'src="data:image/png;base64,{png["image/png"]}" ' if png else ""
    cell = (
        f'<div data-ik="{told["id"]}" style="position:relative;width:100%;height:{height}px;overflow:hidden;background:#f3f5f8">'
        f'<img alt="{html.escape(what)}" {source}style="{place}"></div>'
        f"<script>{_cell_script()}{''.join(calls)}ikCells.add({_literal(told)});</script>"
    )
    return {"text/html": cell, "text/plain": what} | png


def _literal(value: Any) -> str:
    """Write a value as a literal of JavaScript that cannot end the script it stands in."""
    return json.dumps(value).replace("<", "\\u003c")


def _part(text: str) -> tuple[str, str]:
    """Return a shared part of the notebook as (name, text); the name is a hash of the text."""
    return hashlib.sha256(text.encode()).hexdigest()[:12], text


@functools.cache
def _cell_script() -> str:
    """Return the cell's script without its comments and indentation, because every cell has it."""
    text = (importlib.resources.files("ik_toolkit.show") / "cell" / "cell.js").read_text(encoding="utf-8")
    lines = (re.sub(r"(^|\s)//( .*)?$", "", line).strip() for line in text.splitlines())
    return "\n".join(line for line in lines if line) + "\n"


def _meshes(drawn: dict[str, DrawnShape]) -> tuple[str, str]:
    """Return the meshes of a robot as a shared part of the notebook, simplified more than in a saved file (`save`).

    They have at most 16,000 triangles; vertices are rounded to 1/4096 of the robot's size, which compresses well and is invisible.
    """
    small, digest = Window(), hashlib.sha256()
    ends = np.array([end for one in drawn.values() for end in (one.vertices.min(axis=0), one.vertices.max(axis=0))])
    size = float(np.linalg.norm(np.ptp(ends, axis=0)))
    unit = 2.0 ** np.floor(np.log2(max(size, 1e-9) / 4096))
    for (path, one), (vertices, _, faces) in zip(drawn.items(), thin([*drawn.values()], size, 16_000), strict=True):
        rounded = (np.round(vertices / unit) * unit).astype(np.float32)
        small.draw(path, DrawnShape(rounded, faces.astype(np.uint32), one.color, one.opacity))
        digest.update(f"{path} {one.color} {one.opacity}".encode() + rounded.tobytes() + faces.tobytes())
    return digest.hexdigest()[:12], compressed(framed(small.snapshot(small.paths)))


def _short(about: dict[str, Any]) -> dict[str, Any]:
    """Return the page's text and animation; poses are rounded to what can be seen, so that they compress well."""
    made = about["animation"]
    if not made:
        return about
    poses = made["data"]
    unit = 2.0 ** np.floor(np.log2(max(float(np.abs(poses).max()), 1e-9) / 16_384))
    return {**about, "animation": {**made, "data": np.round(poses / unit) * unit}}


class Channel:
    """The connection between a scene in the kernel and the notebook cells that show it: sends changes, receives dragged targets.

    An invisible widget (anywidget) carries the messages.
    """

    def __init__(self, window: Window, dragged: Callable[[str, np.ndarray], None]) -> None:
        """Open the channel; `dragged` is called with the name of a target and its pose (4, 4) [m] in the world.

        Raises MissingExtra without anywidget.
        """
        self.id, self.window, self.dragged = uuid.uuid4().hex, window, dragged
        self.widget, self.handle, self.news = connection(self.id), None, threading.Event()
        self.since, self.feed = Feed(window, lambda: None), Feed(window, self.news.set)
        self.widget.on_msg(self._heard)
        self.feed.take()  # The first cell gets the present contents as HTML, so only later changes are sent.
        threading.Thread(target=self._run, daemon=True, name="ik scene channel").start()

    def shown(self) -> None:
        """Note that a cell now shows the whole scene, so that only later changes are sent to it."""
        self.since.take()
        self.feed.take()
        self.window.feeds |= {self.since, self.feed}

    def display(self) -> None:
        """Display an invisible widget that connects the page with the kernel; it leaves nothing in the saved notebook."""
        from IPython.display import display

        view = {"version_major": 2, "version_minor": 0, "model_id": self.widget.model_id}
        shown = {"application/vnd.jupyter.widget-view+json": view, "text/plain": ""}
        self.handle = display(shown, raw=True, display_id=True)

    def _run(self) -> None:
        while self.news.wait():
            self.news.clear()
            self._send(*self.feed.take())
            time.sleep(0.03)  # at most some thirty pictures a second

    def _send(self, commands: list[dict[str, Any]], about: dict[str, Any]) -> None:
        if commands or about:
            self.widget.send({"about": [as_json(about)] if about else []}, [*map(command_bytes, commands)])

    def _heard(self, widget: Any, content: dict[str, Any], buffers: Any) -> None:
        """Take a message of a page: a cell was opened, or a target dragged."""
        if "open" in content:
            if self.handle is not None:
                self.handle.update({"text/plain": ""}, raw=True)
                self.handle = None
            with self.window.lock:
                self._send(*copy.copy(self.since).take())
        elif "drag" in content:
            try:
                self.dragged(content["drag"], np.array(content["pose"], dtype=float).reshape(4, 4).T)
            finally:
                self.widget.send({"done": 1})


def connection(scene: str) -> Any:
    """Return an invisible widget through which the cells that show a scene (its id) talk to the kernel. Raises MissingExtra."""
    try:
        import anywidget
        import traitlets
    except ImportError:
        raise MissingExtra("anywidget", "notebook") from None
    code = """export default { initialize({ model }) {
        const find = () => window.ikCells ? window.ikCells.channel(model.get("scene"), model) : setTimeout(find, 100);
        find();
    }, render({ el }) { el.style.display = "none"; } };"""
    return type(
        "Connection", (anywidget.AnyWidget,), {"_esm": code, "scene": traitlets.Unicode(scene).tag(sync=True)}
    )()
