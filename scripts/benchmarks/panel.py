"""Latency of the panel while a target is dragged: solve and redraw, and the total time until the page has the new picture.

Run: python scripts/benchmarks/panel.py [ROBOT ...]   (needs the extra panel; this program acts as the page)
"""

import contextlib
import sys
import time

import msgspec  # comes with viser, as the next two
import numpy as np
import viser
import websockets.sync.client
import zstandard

from ik_toolkit.show.panel.panel import Panel

STEPS = 300
CAMERA = {"wxyz": (1, 0, 0, 0), "position": (1, 1, 1), "look_at": (0, 0, 0), "up_direction": (0, 0, 1)}
LENS = {"fov": 1.0, "near": 0.01, "far": 100.0, "image_height": 600, "image_width": 800}


def answered(frame: bytes) -> bool:
    """Whether a frame from the server (two sizes, a packed text, arrays) moves the tip or says why it cannot."""
    size = int.from_bytes(frame[8:16], "little")
    text = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size])
    return b"/tip/" in text or b"stays where it was" in text


def drain(page: websockets.sync.client.ClientConnection, patience: float) -> None:
    """Read pending messages until none arrives for `patience` seconds."""
    with contextlib.suppress(TimeoutError):
        while True:
            page.recv(timeout=patience)


def drag(robot: str) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds for solve and redraw, and until the page has the result, of each step of a drag around the tip."""
    with contextlib.closing(Panel(robot)) as panel:
        address = panel.url.replace("http", "ws", 1)
        with websockets.sync.client.connect(
            address, subprotocols=[f"viser-v{viser.__version__}"], compression=None, max_size=None
        ) as page:

            def say(**message: object) -> None:
                page.send(msgspec.msgpack.encode(message))

            say(type="ViewerCameraMessage", **CAMERA, **LENS)
            while not panel.desks:
                time.sleep(0.01)
            ((number, desk),) = panel.desks.items()
            desk.worker.idle()
            drain(page, 0.5)  # the first picture
            inside, work = [], desk._dragged

            def timed() -> None:
                begun = time.perf_counter()
                work()
                inside.append(time.perf_counter() - begun)

            desk._dragged = timed
            wxyz, start = (
                tuple(map(float, desk.stage.handles[0].gizmo.wxyz)),
                np.array(desk.stage.handles[0].gizmo.position),
            )
            whole = []
            for k in range(1, STEPS + 1):
                place = start + 0.08 * desk.session.robot.reach * np.sin(k / np.array([15.0, 11.0, 19.0]))
                begun = time.perf_counter()
                say(
                    type="TransformControlsUpdateMessage",
                    name=desk.stage.handles[0].gizmo.name,
                    wxyz=wxyz,
                    position=place.tolist(),
                    owner=str(number),
                )
                while not answered(page.recv(timeout=30.0)):
                    pass
                whole.append(time.perf_counter() - begun)
                desk.worker.idle()
                drain(page, 0.03)
            return 1e3 * np.array(inside), 1e3 * np.array(whole)


def main() -> None:
    """Print a table."""
    print("| robot | solve and redraw, median (p99) [ms] | until the page has it, median (p99) [ms] |\n|---|---:|---:|")
    for robot in sys.argv[1:] or ["hydrolek_7w", "panda"]:
        cells = (f"{np.median(x):.1f} ({np.percentile(x, 99):.1f})" for x in drag(robot))
        print(f"| {robot} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
