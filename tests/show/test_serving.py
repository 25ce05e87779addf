"""Served scenes: only to this machine, only with the token, and nothing keeps running."""

import asyncio
import contextlib
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tracemalloc
import urllib.parse
import urllib.request

import numpy as np
import pytest
from robots import load

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

from ik_toolkit.show.scene import view

OPENING = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}  # fmt: skip


def status_of(url, headers):
    """HTTP status of a plain request."""
    parts = urllib.parse.urlsplit(url)
    with contextlib.closing(http.client.HTTPConnection(parts.netloc, timeout=10)) as client:
        client.request("GET", parts.path, headers=headers)
        return client.getresponse().status


def test_live_scene_is_local_and_needs_its_address():
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    robot = load("hydrolek_7w")
    scene = view(robot)
    url = scene.serve()
    assert url == scene.serve() and re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{20,}/", url)
    root = url[: url.index("/", 8) + 1]
    with urllib.request.urlopen(url) as page:
        assert b"live();" in page.read()
    assert status_of(root, {}) == 404
    assert status_of(url + "ws", {**OPENING, "Origin": "http://elsewhere.example"}) == 403
    socket_url = url.replace("http", "ws", 1) + "ws"

    async def talk():
        client = await websocket_connect(HTTPRequest(socket_url, headers={"Origin": root.rstrip("/")}))
        first = [await client.read_message() for _ in range(len(scene.window.snapshot(scene.window.paths)) + 1)]
        scene.show(robot.lower * 0.5)
        moved = [await client.read_message() for _ in range(len(scene.body.parts))]
        client.close()
        while await client.read_message() is not None:  # None: closed; else the socket is left to the collector
            pass
        return first, moved

    first, moved = asyncio.run(talk())
    assert isinstance(first[-1], str) and all(isinstance(m, bytes) for m in moved)
    port = int(url.split(":")[2].split("/")[0])
    scene.close()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


def open_tab(url, **headers):
    """A tab of a live scene that has opened its socket and reads nothing yet."""
    at = urllib.parse.urlsplit(url)
    tab = socket.create_connection((at.hostname, at.port), timeout=10)
    opening = {"Host": at.netloc, "Origin": f"http://{at.netloc}", **OPENING, **headers}
    lines = [f"GET {at.path}ws HTTP/1.1", *(f"{key}: {value}" for key, value in opening.items()), "", ""]
    tab.sendall("\r\n".join(lines).encode())
    stream = tab.makefile("rb")
    status = int(stream.readline().split()[1])
    while stream.readline().strip():
        pass
    return tab, stream, status


def frames_of(stream):
    """Messages of a web socket, as they come: bytes, or str."""
    while True:
        kind, size = stream.read(2)
        size &= 127
        size = int.from_bytes(stream.read({126: 2, 127: 8}[size]), "big") if size > 125 else size
        data = stream.read(size)
        yield data.decode() if kind & 15 == 1 else data


def test_a_tab_that_never_reads_holds_no_frames():
    """Frames it has not taken are dropped; when it reads again it gets the latest state, whatever came in between."""
    import umsgpack

    robot = load("hydrolek_7w")
    scene = view(robot)
    tab, stream, status = open_tab(scene.serve())
    assert status == 101
    rng = np.random.default_rng(0)
    poses = {path: np.eye(4) for path in scene.window.transforms}
    tracemalloc.start()
    try:
        for k in range(1500):
            for path, T in poses.items():
                scene.window.place(path, T)
            scene.window.delete(f"never_{k}")  # names without end
            scene.say(f"{k}")
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert grown < 1e6  # over 10 MB when every frame waited
    for k in range(20):
        scene.show(robot.random_q(rng))
        scene.trail(rng.random((20, 3)), f"trail_{k % 7}")
        scene.window.delete(f"trail_{(k + 1) % 7}")
    scene.say("the end")
    shown, objects = {}, set()
    for message in frames_of(stream):
        if isinstance(message, str):
            if "the end" in json.loads(message).get("lines", ()):
                break
            continue
        command = umsgpack.unpackb(message)
        path = command["path"].removeprefix("/meshcat/")
        if command["type"] == "set_transform":
            shown[path] = np.reshape(command["matrix"], (4, 4)).T
        elif command["type"] == "delete":
            objects = {p for p in objects if path and p != path and not p.startswith(path + "/")}
        else:
            objects.add(path)
    tab.close()
    scene.close()
    assert objects == {*scene.window.objects, *scene.window.copies}
    for path, T in scene.window.transforms.items():
        assert np.array_equal(shown[path], T), path


def test_the_scene_is_shown_to_nobody_without_its_token():
    scene = view(load("planar_2r"))
    url = scene.serve()
    token = urllib.parse.urlsplit(url).path.strip("/")
    root = url[: url.index("/", 8) + 1]
    for word in ("", "x", token[:-1], token + "x", token.swapcase(), "x" * 5000, "%00", "..", f"x/../{token}"):
        for name in ("", "viewer.js", "ws"):
            assert status_of(f"{root}{word}/{name}", {}) == 404
    for tab, stream, status in (
        open_tab(f"{root}x/"),
        open_tab(url, Origin="http://elsewhere.example"),
        open_tab(url, Host="rebound.example"),
        open_tab(url, Accept="*/*\r\nHost: rebound.example"),
        open_tab(url, Accept="*/*\r\nOrigin: http://elsewhere.example"),
    ):
        assert status in (400, 403, 404)  # 400: tornado itself refuses two Host
        stream.close()
        tab.close()
    assert status_of(url, {"Host": "rebound.example"}) == 403
    assert status_of(url, {}) == status_of(url + "viewer.js", {}) == 200
    scene.close()


def test_a_port_in_use_is_an_error():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(OSError, match="in use"):
            view(load("planar_2r")).serve(taken.getsockname()[1])


@pytest.mark.parametrize(
    ("command", "end"),
    [
        pytest.param("view planar_2r --no-open", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("view planar_2r --no-open", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("panel planar_2r --no-open", signal.SIGTERM, marks=pytest.mark.slow),
        ("panel planar_2r --no-open", signal.SIGINT),
        pytest.param("solve planar_2r --xyz 1 1 0 --view", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_no_server_is_left_after_a_signal(command, end):
    if command.startswith("panel"):
        pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
    run = subprocess.Popen(
        [sys.executable, "-m", "ik_toolkit", *command.split()],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONWARNINGS": "default", "BROWSER": "true"},  # the command `true` opens nothing
    )
    line = ""
    while "http://" not in line:
        line = run.stderr.readline()
        assert line, "the command ended before it served"
    url = re.search(r"http://\S+/", line)[0]
    at = urllib.parse.urlsplit(url)
    assert len(at.path.strip("/")) > 20 and status_of(url, {}) == 200  # the address printed is the whole one
    assert status_of(f"http://{at.netloc}/", {}) in (403, 404)
    run.send_signal(end)
    assert run.wait(20) == 0
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", at.port)) != 0
    assert "Traceback" not in run.stderr.read()
    run.stderr.close()
