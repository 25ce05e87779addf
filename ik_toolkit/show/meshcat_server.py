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
import socket
import threading
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..files import as_output, write_whole
from .access import below, new_token, refused_request
from .body import DrawnShape
from .feed import ROOT, Feed, as_json, command_bytes, meshcat_module

HOST = "127.0.0.1"
SHADE = 0.86  # factor on all colours, because under the viewer's lights pure white shows no shading


def _number(color: tuple[float, ...]) -> int:
    r, g, b = (round(255 * min(1.0, max(0.0, c))) for c in color)
    return r << 16 | g << 8 | b


def compressed(data: bytes) -> str:
    """Compress bytes by gzip and return them as base64 text, to be put into a page."""
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode()


def framed(commands: list[dict[str, Any]]) -> bytes:
    """Return viewer commands as one byte string, each command preceded by its length (4 bytes)."""
    return b"".join(len(data).to_bytes(4, "little") + data for data in map(command_bytes, commands))


class Cloud(NamedTuple):
    """A point cloud to draw: points (N, 3) [m] with colors (N, 3) in 0..1, drawn with a diameter `size` [m]."""

    points: np.ndarray
    colors: np.ndarray
    size: float


class Copy(NamedTuple):
    """A shape that is drawn like the one at the path `source`, in another colour; its triangles need not be sent again."""

    source: str
    color: tuple[float, float, float]
    opacity: float


class Window:
    """The contents of a 3-D scene, from which pages are made: shapes and transforms (4, 4) by path, texts and camera (`about`)."""

    def __init__(self) -> None:
        """Start with an empty scene."""
        meshcat_module()
        self.objects: dict[str, DrawnShape | Cloud] = {}
        self.copies: dict[str, Copy] = {}
        self.transforms: dict[str, np.ndarray] = {}
        self.about: dict[str, Any] = {"title": "", "camera": None, "animation": None}
        self.about |= {"lines": [], "legend": [], "names": []}
        self.feeds: set[Feed] = set()
        self.lock = threading.RLock()
        self.server: Server | None = None

    def _keep(self, kept: dict[str, Any], path: str, what: Any) -> None:
        with self.lock:
            kept[path] = what
            for feed in self.feeds:
                feed.changed(path)

    def draw(self, path: str, what: DrawnShape | Cloud | Copy) -> None:
        """Draw something (triangles, points or a copy) in the scene, under the name `path`."""
        self._keep(self.copies if isinstance(what, Copy) else self.objects, path, what)

    def place(self, path: str, T: np.ndarray) -> None:
        """Set the pose (4, 4) [m] of the object at a path, in the frame of the path above it ("robot" for "robot/hand")."""
        self._keep(self.transforms, path, np.array(T, dtype=float))

    def pose(self, path: str) -> np.ndarray:
        """Return the world pose (4, 4) [m] of the object at a path: the product of the poses of all paths above it and its own."""
        words, T = path.split("/"), np.eye(4)
        for k in range(len(words)):
            T = T @ self.transforms.get("/".join(words[: k + 1]), np.eye(4))
        return T

    def delete(self, path: str) -> None:
        """Remove what is drawn at a path and everything below it from the scene."""
        with self.lock:
            for kept in (self.objects, self.copies, self.transforms):
                for key in [k for k in kept if k == path or k.startswith(path + "/")]:
                    del kept[key]
            for feed in self.feeds:
                feed.deleted(path)

    def say(self, **about: Any) -> None:
        """Change texts of the page (title, lines, legend, names of frames), its camera or its animation, given by keyword."""
        with self.lock:
            self.about.update(about)
            for feed in self.feeds:
                feed.told(about)

    def animate(self, paths: Sequence[str], poses: np.ndarray, labels: Sequence[str], fps: float, first: int) -> None:
        """Set the page's animation: objects at `paths` go through poses (F, paths, 3 or 4, 4) [m], with a label for each frame.

        fps: frames per second; first: number of the frame that is shown at first.
        """
        made = {"paths": [ROOT + path for path in paths], "count": len(poses), "first": first}
        self.say(animation={**made, "fps": fps, "labels": labels, "data": poses[:, :, :3]})

    def drawing(self, path: str) -> dict[str, Any]:
        """Return the meshcat command that draws the shape or point cloud at a path."""
        g, drawn = meshcat_module().geometry, self.objects[path]
        if isinstance(drawn, Cloud):
            cloud = g.PointsGeometry(drawn.points.T.astype(np.float32), drawn.colors.T.astype(np.float32))
            made = g.Points(cloud, g.PointsMaterial(size=drawn.size))
        else:
            color, clear = _number(tuple(SHADE * c for c in drawn.color)), drawn.opacity < 1.0
            look = g.MeshPhongMaterial(color=color, opacity=drawn.opacity, transparent=clear, shininess=22)
            made = g.Mesh(g.TriangularMeshGeometry(drawn.vertices, drawn.faces), look)
        return {"type": "set_object", "path": ROOT + path, "object": made.lower()}

    @property
    def paths(self) -> set[str]:
        """All paths at which something is drawn or placed."""
        return {*self.objects, *self.copies, *self.transforms}

    def snapshot(self, paths: Container[str]) -> list[dict[str, Any]]:
        """Return the viewer commands that draw and place the objects at some paths, in the order in which they must be sent."""
        with self.lock:
            drawn = [self.drawing(path) for path in self.objects if path in paths]
            for path, (source, color, opacity) in self.copies.items():
                if path in paths:
                    look = {"color": _number(color), "opacity": float(opacity)}
                    drawn.append({"type": "copy", "path": ROOT + path, "source": ROOT + source, **look})
            for path, T in self.transforms.items():
                if path in paths:
                    drawn.append({"type": "set_transform", "path": ROOT + path, "matrix": T.T.ravel().tolist()})
            return drawn

    # ------------------------------------------------------------------------------------------------------- pages
    def _page(self, body: str) -> str:
        files = importlib.resources.files("ik_toolkit.show")
        page = (files / "scene.html").read_text(encoding="utf-8")
        # The title is inserted last, because a robot's name might contain the other placeholder.
        return page.replace("/*@START@*/", body).replace("@TITLE@", html.escape(self.about["title"]))

    def html(self) -> str:
        """Return the scene as one page that needs no network."""
        parts = viewer_script(), framed(self.snapshot(self.paths)), as_json(self.about).encode()
        texts = ", ".join(f'"{compressed(part)}"' for part in parts)
        return self._page(f"still({texts});")

    def serve(self, port: int = 0) -> str:
        """Serve the live scene on 127.0.0.1 and return its address; a second call returns the same address."""
        if self.server is None:
            self.server = Server(self, port)
        return self.server.url

    def close(self) -> None:
        """Stop serving the scene over the network; it can still be changed and saved."""
        if self.server is not None:
            self.server.stop()
            self.server = None


def write_page(path: str | Path, what: str, html: Callable[[], str]) -> Path:
    """Write the scene as a self-contained page (see `html`) to a file; return the path of the file.

    Raises InvalidOption if the name does not end in .html.
    """
    file = as_output(path, what, ".html", ".htm")
    write_whole(file, html())
    return file


def viewer_script() -> bytes:
    """Return the JavaScript of the meshcat viewer, from the package meshcat; it loads nothing from the network."""
    meshcat_module()
    return (importlib.resources.files("meshcat") / "viewer" / "dist" / "main.min.js").read_bytes()


class Server:
    """A web server, in a thread of its own, that shows one scene live: page, script and a web socket below an unguessable path.

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
        page, script, socket = handlers(self.window, self.token)
        routes: Any = [("/[^/]*/", page), ("/[^/]*/viewer[.]js", script), ("/[^/]*/ws", socket)]
        server = tornado.httpserver.HTTPServer(tornado.web.Application(routes, log_function=lambda _: None))
        server.add_sockets([self._socket])
        self._ready.set()
        await self._stop.wait()
        server.stop()
        await server.close_all_connections()

    def stop(self) -> None:
        """Close the server's port and end its thread."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(5.0)


def handlers(window: Window, token: str) -> tuple[Any, Any, Any]:
    """Make the page, script and web-socket handlers of a window; tornado is imported here, because only serving needs it."""
    import tornado.iostream
    import tornado.web
    import tornado.websocket

    class Door(tornado.web.RequestHandler):
        def prepare(self) -> None:
            if refused_request(self.request.headers, HOST):
                raise tornado.web.HTTPError(http.client.FORBIDDEN)
            if below(self.request.path, token) is None:
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
            news.set()
            self.writer = loop.create_task(self.write_all(news))

        async def write_all(self, news: asyncio.Event) -> None:
            with contextlib.suppress(tornado.websocket.WebSocketClosedError, tornado.iostream.StreamClosedError):
                while True:
                    await news.wait()
                    news.clear()
                    commands, about = self.feed.take()
                    for command in commands:
                        # waits until the page has taken the message, so that messages do not pile up
                        await self.write_message(command_bytes(command), binary=True)
                    if about:
                        await self.write_message(as_json(about))

        def on_message(self, message: str | bytes) -> None:
            """Ignore what the page sends, because this page only shows."""

        def on_close(self) -> None:
            with window.lock:
                window.feeds.discard(self.feed)
            self.writer.cancel()

    return Page, Script, Socket
