"""Changes of a scene that are not yet sent to an open page, or to a viewer of the caller (meshcat, Pinocchio)."""

import base64
import json
import warnings
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..errors import InvalidOption, MissingExtra

ROOT = "/meshcat/"
MOST_GONE = 1000  # largest number of deletions kept for a page that does not fetch its updates


def meshcat_module() -> Any:
    """Import meshcat without the warnings about its own imports."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import meshcat
        except ImportError:
            raise MissingExtra("meshcat", "view") from None
    return meshcat


def command_bytes(command: dict[str, Any]) -> bytes:
    """Pack a meshcat command as the bytes that a page reads."""
    import umsgpack

    return umsgpack.packb(command)


def as_json(about: dict[str, Any]) -> str:
    """Return text, camera and animation of a page as JSON; arrays become the base64 text of their numbers (float32)."""
    return json.dumps(about, default=lambda array: base64.b64encode(array.astype("<f4").tobytes()).decode())


class Feed:
    """Collects what has changed in a scene since one open page was last brought up to date.

    It stores which objects (paths) changed, not how often, so that memory does not grow for a page that does not read. At first
    everything is unsent; `wake` is called at the first change after a `take`. The methods `changed`, `deleted` and `told` may be
    called only with the window's lock held.
    """

    def __init__(self, window: Any, wake: Callable[[], None]) -> None:
        """Start with everything unsent."""
        self.window, self._wake = window, wake
        self._awake = True
        self._gone: set[str] = set()
        self._paths: set[str] = window.paths
        self._about = dict(window.about)

    def _news(self) -> None:
        if not self._awake:
            self._awake = True
            self._wake()

    def changed(self, path: str) -> None:
        """Note that what is drawn at a path, or its pose, has changed, so that `take` sends both."""
        self._paths.add(path)
        self._news()

    def deleted(self, path: str) -> None:
        """Note that a path and everything below it were deleted, so that `take` deletes them from the page."""
        self._paths = {p for p in self._paths if p != path and not p.startswith(path + "/")}
        self._gone = {p for p in self._gone if not p.startswith(path + "/")} | {path}
        # Rather than a long list of deletions, the page gets one that clears it, and is drawn anew.
        if len(self._gone) > MOST_GONE:
            self._gone, self._paths = {""}, self.window.paths
        self._news()

    def told(self, about: dict[str, Any]) -> None:
        """Note that parts of the page's text, camera or animation have changed, so that `take` returns them."""
        self._about.update(about)
        self._news()

    def take(self) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Return what has changed since the last call: the commands that draw it, and new texts, camera or animation."""
        with self.window.lock:
            self._awake = False
            gone, paths, about = self._gone, self._paths, self._about
            self._gone, self._paths, self._about = set(), set(), {}
            erased = [{"type": "delete", "path": ROOT + path} for path in gone]
            return [*erased, *self.window.snapshot(paths)], about


class Guest:
    """Draws a scene also in a viewer that the user has opened: a meshcat Visualizer, or Pinocchio's MeshcatVisualizer.

    In Pinocchio's viewer the robot is already loaded, so it is only moved.
    """

    def __init__(self, window: Any, viewer: Any, parts: Iterable[str]) -> None:
        """Clear earlier drawings of this package in the viewer; parts: names of the robot's parts. Raises InvalidOption."""
        meshcat, group = getattr(viewer, "viewer", viewer), getattr(viewer, "viewerVisualGroupName", "")
        if not isinstance(meshcat, meshcat_module().Visualizer) or (meshcat is not viewer and not group):
            known = "a meshcat.Visualizer, or Pinocchio's MeshcatVisualizer after initViewer() and loadViewerModel()"
            raise InvalidOption(f"viewer must be {known}, not {viewer!r:.60}")
        theirs = {f"robot/{shape.name}": shape for shape in viewer.visual_model.geometryObjects} if group else {}
        if others := sorted({shape.name for shape in theirs.values()} - {*parts}):
            raise InvalidOption(
                f"the viewer draws '{others[0]}', no part of this robot; make it with ik.Robot(model, visual_model=)"
            )
        self._nodes = {path: meshcat[f"{group}/{shape.name}"] for path, shape in theirs.items()}
        self._scales = {path: np.repeat([*shape.meshScale, 1.0], 4) for path, shape in theirs.items()}
        self._window, self._scene = window, meshcat["ik_toolkit"]
        self._scene.delete()
        self._scene.set_animation(meshcat_module().animation.Animation(), play=False)
        self._feed = Feed(window, self.update)
        window.feeds.add(self._feed)
        self.update()

    def update(self) -> None:
        """Send to the user's viewer what has changed in the scene, except texts, legend and camera."""
        commands, about = self._feed.take()
        for command in commands:
            self._send(command)
        if motion := about.get("animation"):
            self._scene.set_animation(self._animation(motion))

    def _send(self, command: dict[str, Any]) -> None:
        path = command["path"].removeprefix(ROOT)
        # The user's viewer does not know the command "copy", so the shape itself is sent in the other colour.
        if command["type"] == "copy":
            made = self._window.drawing(command["source"].removeprefix(ROOT))["object"]
            made["materials"][0] |= {"color": command["color"], "opacity": command["opacity"], "transparent": True}
            command = {"type": "set_object", "object": made}
        elif command["type"] == "set_object" and path.rpartition("/")[0] in self._nodes:
            return
        elif command["type"] == "set_transform" and path in self._nodes:
            command["matrix"] = (self._scales[path] * command["matrix"]).tolist()
        sent = {**command, "path": self._node(path).path.lower()}
        self._scene.window.send(SimpleNamespace(lower=lambda: sent))

    def _node(self, path: str) -> Any:
        return self._nodes.get(path) or self._scene[path]

    def _animation(self, motion: dict[str, Any]) -> Any:
        made = meshcat_module().animation.Animation(default_framerate=motion["fps"])
        for path, rows in zip(motion["paths"], motion["data"].swapaxes(0, 1), strict=True):
            for k, T in enumerate(rows):
                made.at_frame(self._node(path.removeprefix(ROOT)), k).set_transform(
                    np.vstack([T, [0.0, 0.0, 0.0, 1.0]])
                )
        return made
