"""A meshcat scene inside this process: a self-contained page, or a live one served on loopback by a thread.

The stock meshcat server is a second process that survives a SIGTERM, and its page cannot set the camera or show an
animation's frames. Here the same viewer script is used, but the server ends with the program.
"""

import asyncio
import base64
import contextlib
import gzip
import html
import http.client
import importlib.resources
import json
import socket
import threading
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..files import as_output, write_whole
from .access import below, new_token, refused_request
from .body import DrawnShape
from .feed import ROOT, Feed, meshcat_module, scene_command

HOST = "127.0.0.1"
SHADE = 0.86  # Colours are multiplied by this, because under the viewer's lights pure white shows no shape.


def _number(color: tuple[float, ...]) -> int:
    r, g, b = (round(255 * min(1.0, max(0.0, c))) for c in color)
    return r << 16 | g << 8 | b


def compressed(data: bytes) -> str:
    """Return compressed data as text."""
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode()


def framed(commands: list[bytes]) -> bytes:
    """Concatenate viewer commands, each preceded by its length."""
    return b"".join(len(command).to_bytes(4, "little") + command for command in commands)


class Window:
    """Contents of a scene: meshcat commands by path, transforms (read by tests), and the page's text and camera (`about`)."""

    def __init__(self) -> None:
        """Start with an empty scene."""
        meshcat_module()
        self.objects: dict[str, bytes] = {}
        self.copies: dict[str, bytes] = {}
        self.transforms: dict[str, np.ndarray] = {}
        self.about: dict[str, Any] = {"title": "", "camera": None, "animation": None}
        self.about |= {"lines": [], "legend": [], "names": []}
        self.feeds: set[Feed] = set()
        self.lock = threading.RLock()
        self.server: Server | None = None

    def _keep(self, kept: dict[str, bytes], command: dict[str, Any]) -> None:
        with self.lock:
            kept[command["path"]] = scene_command(command)
            for feed in self.feeds:
                feed.changed(command["path"])

    def shape(self, path: str, shape: DrawnShape) -> None:
        """Draw triangles at a path."""
        g = meshcat_module().geometry
        material = g.MeshPhongMaterial(
            color=_number(tuple(SHADE * c for c in shape.color)),
            opacity=shape.opacity,
            transparent=shape.opacity < 1.0,
            shininess=22,
        )
        mesh = g.Mesh(g.TriangularMeshGeometry(shape.vertices, shape.faces), material)
        self._keep(self.objects, {"type": "set_object", "path": path, "object": mesh.lower()})

    def points(self, path: str, points: np.ndarray, colors: np.ndarray, size: float) -> None:
        """Draw a cloud of points (N, 3) [m] with colors (N, 3) in 0..1 and a size [m]."""
        g = meshcat_module().geometry
        cloud = g.PointsGeometry(points.T.astype(np.float32), colors.T.astype(np.float32))
        made = g.Points(cloud, g.PointsMaterial(size=size))
        self._keep(self.objects, {"type": "set_object", "path": path, "object": made.lower()})

    def copy(self, path: str, source: str, color: tuple[float, float, float], opacity: float) -> None:
        """Draw the shape of another path again in another colour, without sending its triangles again."""
        look = {"color": _number(color), "opacity": float(opacity)}
        self._keep(self.copies, {"type": "copy", "path": path, "source": ROOT + source, **look})

    def place(self, path: str, T: np.ndarray) -> None:
        """Set the pose (4, 4) [m] of a path in its parent."""
        with self.lock:
            self.transforms[path] = np.array(T, dtype=float)
            for feed in self.feeds:
                feed.changed(path)

    def pose(self, path: str) -> np.ndarray:
        """Return the pose (4, 4) [m] of a path in the world: the product of the poses of all paths above it and its own."""
        words, T = path.split("/"), np.eye(4)
        for k in range(len(words)):
            T = T @ self.transforms.get("/".join(words[: k + 1]), np.eye(4))
        return T

    def delete(self, path: str) -> None:
        """Remove a path and everything below it."""
        with self.lock:
            for kept in (self.objects, self.copies, self.transforms):
                for key in [k for k in kept if k == path or k.startswith(path + "/")]:
                    del kept[key]
            for feed in self.feeds:
                feed.deleted(path)

    def say(self, **about: Any) -> None:
        """Change title, lines, legend, names of frames, camera or animation of the page."""
        with self.lock:
            self.about.update(about)
            for feed in self.feeds:
                feed.told(about)

    def animate(self, paths: Sequence[str], poses: np.ndarray, labels: Sequence[str], fps: float, first: int) -> None:
        """Let paths go through poses (F, paths, 3 or 4, 4) [m], with a label for each frame; frame number `first` is shown."""
        data = base64.b64encode(np.ascontiguousarray(poses[:, :, :3], dtype="<f4").tobytes()).decode()
        made = {"paths": [ROOT + path for path in paths], "count": len(poses), "first": first}
        self.say(animation={**made, "fps": fps, "labels": labels, "data": data})

    def snapshot(self, paths: Container[str] | None = None) -> list[bytes]:
        """Return the commands, in order, that draw the scene anew, or only some paths in it."""

        def wanted(path: str) -> bool:
            return paths is None or path in paths

        with self.lock:
            drawn = [kept[path] for kept in (self.objects, self.copies) for path in kept if wanted(path)]
            return drawn + [
                scene_command({"type": "set_transform", "path": path, "matrix": T.T.ravel().tolist()})
                for path, T in self.transforms.items()
                if wanted(path)
            ]

    # ------------------------------------------------------------------------------------------------------- pages
    def _page(self, body: str) -> str:
        files = importlib.resources.files("ik_toolkit.show")
        page = (files / "scene.html").read_text(encoding="utf-8")
        # The title is replaced last, so that a robot's name cannot contain a word that is replaced.
        return page.replace("/*@START@*/", body).replace("@TITLE@", html.escape(self.about["title"]))

    def html(self) -> str:
        """Return the scene as one page that needs no network."""
        parts = viewer_script(), framed(self.snapshot()), json.dumps(self.about).encode()
        texts = ", ".join(f'"{compressed(part)}"' for part in parts)
        return self._page(f"still({texts});")

    def serve(self, port: int = 0) -> str:
        """Serve the live scene on 127.0.0.1 and return its address; a second call returns the same address."""
        if self.server is None:
            self.server = Server(self, port)
        return self.server.url

    def close(self) -> None:
        """Stop serving the scene."""
        if self.server is not None:
            self.server.stop()
            self.server = None


def write_page(path: str | Path, what: str, html: Callable[[], str]) -> Path:
    """Write the output of `html` to a file and return its path.

    Raises InvalidOption if the name does not end in .html.
    """
    file = as_output(path, what, ".html", ".htm")
    write_whole(file, html())
    return file


def viewer_script() -> bytes:
    """Return the viewer script of the meshcat package, which is one file without external addresses."""
    meshcat_module()
    return (importlib.resources.files("meshcat") / "viewer" / "dist" / "main.min.js").read_bytes()


class Server:
    """Serves one window from a daemon thread: page, script and a web socket below an unguessable path.

    It is bound to 127.0.0.1 only; requests from other sites are refused, and nothing is served without the token. The
    thread ends with the process, even if that is killed.
    """

    def __init__(self, window: Window, port: int = 0) -> None:
        """Start the server; port 0 takes a free one. Raises OSError if the port is taken."""
        self.window = window
        self.token = new_token()
        self._socket = socket.create_server((HOST, port))
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self.url = f"http://{HOST}:{self.port}/{self.token}/"
        self._ready = threading.Event()
        self._thread = threading.Thread(target=asyncio.run, args=(self._run(),), daemon=True, name="ik scene server")
        self._thread.start()
        self._ready.wait()

    async def _run(self) -> None:
        import tornado.httpserver
        import tornado.web

        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        names = ("", "viewer.js", "ws")
        routes = [
            ("/[^/]*/" + name.replace(".", "[.]"), made, {"token": self.token})
            for name, made in zip(names, handlers(self.window), strict=True)
        ]
        server = tornado.httpserver.HTTPServer(tornado.web.Application(routes, log_function=lambda _: None))
        server.add_sockets([self._socket])
        self._ready.set()
        await self._stop.wait()
        server.stop()
        await server.close_all_connections()

    def stop(self) -> None:
        """Close the port and end the thread."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(5.0)


def handlers(window: Window) -> tuple[Any, Any, Any]:
    """Make the page, script and web-socket handlers of a window; tornado is imported here, because only serving needs it."""
    import tornado.iostream
    import tornado.web
    import tornado.websocket

    class Door(tornado.web.RequestHandler):
        def initialize(self, token: str) -> None:
            self.token = token

        def prepare(self) -> None:
            if refused_request(self.request.headers, HOST):
                raise tornado.web.HTTPError(http.client.FORBIDDEN)
            if below(self.request.path, self.token) is None:
                raise tornado.web.HTTPError(http.client.NOT_FOUND)

    class Page(Door):
        def get(self) -> None:
            self.write(window._page("live();"))

    class Script(Door):
        def get(self) -> None:
            self.set_header("Content-Type", "text/javascript; charset=utf-8")
            self.write(viewer_script())

    class Socket(Door, tornado.websocket.WebSocketHandler):
        def open(self, *args: str, **kwargs: str) -> None:
            loop, news = asyncio.get_running_loop(), asyncio.Event()

            def wake() -> None:
                with contextlib.suppress(RuntimeError):  # The server may have stopped in the meantime.
                    loop.call_soon_threadsafe(news.set)

            with window.lock:
                self.feed = Feed(window, wake)
                window.feeds.add(self.feed)
            self.writer = loop.create_task(self.write_all(news))

        async def write_all(self, news: asyncio.Event) -> None:
            with contextlib.suppress(tornado.websocket.WebSocketClosedError, tornado.iostream.StreamClosedError):
                while True:
                    await news.wait()
                    news.clear()
                    for data in self.feed.take():
                        # The call waits until the page can take the message.
                        await self.write_message(data, binary=isinstance(data, bytes))

        def on_message(self, message: str | bytes) -> None:
            """Ignore messages from the page."""

        def on_close(self) -> None:
            with window.lock:
                window.feeds.discard(self.feed)
            self.writer.cancel()

    return Page, Script, Socket
