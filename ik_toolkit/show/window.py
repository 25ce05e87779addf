"""A meshcat scene kept in this process: a self-contained page, or a live one served on loopback by a thread of our own.

The stock meshcat server is a second process that survives a SIGTERM, and its page can neither be aimed nor show an
animation's frames; here the same viewer script draws, and nothing outlives the program.
"""

import asyncio
import base64
import gzip
import html
import importlib.resources
import json
import secrets
import socket
import threading
import warnings
from typing import Any

import numpy as np

from ..errors import MissingExtra
from .parts import Shape

ROOT = "/meshcat/"
SHADE = 0.86  # of a colour: under the viewer's lights pure white has no form left


def _meshcat() -> Any:
    """Import meshcat, which warns about its own imports."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import meshcat
            import meshcat.commands
            import meshcat.geometry
        except ImportError:
            raise MissingExtra("meshcat", "view") from None
    return meshcat


def _number(color: tuple[float, ...]) -> int:
    r, g, b = (round(255 * min(1.0, max(0.0, c))) for c in color)
    return r << 16 | g << 8 | b


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode()


class Window:
    """What is drawn: commands by path, transforms for inspection, and what the page says about them (`about`)."""

    def __init__(self) -> None:
        """An empty scene."""
        _meshcat()
        self.objects: dict[str, bytes] = {}
        self.copies: dict[str, bytes] = {}
        self.transforms: dict[str, np.ndarray] = {}
        self.about: dict[str, Any] = {"title": "", "lines": [], "legend": [], "camera": None, "animation": None}
        self.listeners: set[Any] = set()
        self.lock = threading.RLock()
        self.server: Server | None = None

    def _send(self, kept: dict[str, bytes] | None, command: dict[str, Any]) -> None:
        import umsgpack

        data = umsgpack.packb({**command, "path": ROOT + command["path"]})
        with self.lock:
            if kept is not None:
                kept[command["path"]] = data
            for put in list(self.listeners):
                put(data)

    def shape(self, path: str, shape: Shape) -> None:
        """Draw triangles at a path."""
        g = _meshcat().geometry
        material = g.MeshPhongMaterial(
            color=_number(tuple(SHADE * c for c in shape.color)),
            opacity=shape.opacity,
            transparent=shape.opacity < 1.0,
            shininess=22,
        )
        mesh = g.Mesh(g.TriangularMeshGeometry(shape.vertices, shape.faces), material)
        self._send(self.objects, {"type": "set_object", "path": path, "object": mesh.lower()})

    def points(self, path: str, points: np.ndarray, colors: np.ndarray, size: float) -> None:
        """Draw a cloud: points (N, 3) [m], colors (N, 3) in 0..1, size [m]."""
        g = _meshcat().geometry
        cloud = g.PointsGeometry(points.T.astype(np.float32), colors.T.astype(np.float32))
        self._send(
            self.objects,
            {"type": "set_object", "path": path, "object": g.Points(cloud, g.PointsMaterial(size=size)).lower()},
        )

    def copy(self, path: str, source: str, color: tuple[float, float, float], opacity: float) -> None:
        """Draw what another path shows once more, in another colour, without sending its triangles again."""
        self._send(
            self.copies,
            {"type": "copy", "path": path, "source": ROOT + source, "color": _number(color), "opacity": float(opacity)},
        )

    def place(self, path: str, T: np.ndarray) -> None:
        """Set the pose (4, 4) [m] of a path in its parent."""
        self.transforms[path] = np.array(T, dtype=float)
        self._send(None, self._placing(path))

    def _placing(self, path: str) -> dict[str, Any]:
        return {"type": "set_transform", "path": path, "matrix": self.transforms[path].T.ravel().tolist()}

    def delete(self, path: str) -> None:
        """Remove a path and everything below it."""
        for kept in (self.objects, self.copies, self.transforms):
            for key in [k for k in kept if k == path or k.startswith(path + "/")]:
                del kept[key]
        self._send(None, {"type": "delete", "path": path})

    def say(self, **about: Any) -> None:
        """Change title, lines, legend, camera or animation of the page."""
        self.about.update(about)
        with self.lock:
            for put in list(self.listeners):
                put(json.dumps(about))

    def snapshot(self) -> list[bytes]:
        """All commands that rebuild the scene, in order."""
        import umsgpack

        with self.lock:
            placed = [{**self._placing(path), "path": ROOT + path} for path in self.transforms]
            return [*self.objects.values(), *self.copies.values(), *(umsgpack.packb(c) for c in placed)]

    # ------------------------------------------------------------------------------------------------------- pages
    def _page(self, body: str) -> str:
        files = importlib.resources.files("ik_toolkit.show")
        page = (files / "scene.html").read_text(encoding="utf-8")
        return page.replace("@TITLE@", html.escape(self.about["title"])).replace("/*@START@*/", body)

    def html(self) -> str:
        """The scene as one page that asks nothing of any network."""
        blob = b"".join(len(d).to_bytes(4, "little") + d for d in self.snapshot())
        about = json.dumps(self.about).encode()
        return self._page(f'still("{_packed(viewer_script())}", "{_packed(blob)}", "{_packed(about)}");')

    def serve(self, port: int = 0) -> str:
        """Serve the live scene on 127.0.0.1 and return its address; a second call returns the same address."""
        if self.server is None:
            self.server = Server(self, port)
        return self.server.url

    def close(self) -> None:
        """Stop serving."""
        if self.server is not None:
            self.server.stop()
            self.server = None


def viewer_script() -> bytes:
    """Return the viewer of the meshcat package (one file, no outside addresses)."""
    _meshcat()
    return (importlib.resources.files("meshcat") / "viewer" / "dist" / "main.min.js").read_bytes()


class Server:
    """Serves one window from a daemon thread: page, script and a web socket below an unguessable path.

    Bound to 127.0.0.1 only; a socket opened by another site's page is refused (Origin must match), and without the token
    there is nothing to see. The thread ends with the process, also when that is killed.
    """

    def __init__(self, window: Window, port: int = 0) -> None:
        """Start; port 0 takes a free one. Raises OSError when the port is taken."""
        self.window = window
        self.token = secrets.token_urlsafe(16)
        self._socket = socket.create_server(("127.0.0.1", port))
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/{self.token}/"
        self._ready = threading.Event()
        self._thread = threading.Thread(target=asyncio.run, args=(self._run(),), daemon=True, name="ik scene server")
        self._thread.start()
        self._ready.wait()

    async def _run(self) -> None:
        import tornado.httpserver
        import tornado.web

        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        page, script, feed = handlers(self.window)
        at = f"/{self.token}/"
        server = tornado.httpserver.HTTPServer(
            tornado.web.Application(
                [(at, page), (at + "viewer.js", script), (at + "ws", feed)], log_function=lambda _: None
            )
        )
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
    """Page, script and web-socket handlers of a window (made here: tornado is imported only when serving)."""
    import tornado.web
    import tornado.websocket

    class Page(tornado.web.RequestHandler):
        def get(self) -> None:
            self.write(window._page("live();"))

    class Script(tornado.web.RequestHandler):
        def get(self) -> None:
            self.set_header("Content-Type", "text/javascript; charset=utf-8")
            self.write(viewer_script())

    class Socket(tornado.websocket.WebSocketHandler):
        def open(self, *args: str, **kwargs: str) -> None:
            loop = asyncio.get_running_loop()

            async def write(data: bytes | str) -> None:
                try:
                    await self.write_message(data, binary=isinstance(data, bytes))
                except (tornado.websocket.WebSocketClosedError, tornado.iostream.StreamClosedError):
                    window.listeners.discard(self.forward)

            self.forward = lambda data: loop.call_soon_threadsafe(lambda: loop.create_task(write(data)))
            with window.lock:
                for data in window.snapshot():
                    self.forward(data)
                self.forward(json.dumps(window.about))
                window.listeners.add(self.forward)

        def on_message(self, message: str | bytes) -> None:
            """Nothing is taken from the page."""

        def on_close(self) -> None:
            window.listeners.discard(self.forward)

    return Page, Script, Socket
