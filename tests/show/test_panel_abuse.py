"""The panel under abuse: many visitors, invalid messages, visitors who leave at any time. No browser is needed."""

import contextlib
import gc
import math
import random
import threading
import time
import tracemalloc

import numpy as np
import pytest

viser = pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")
import msgspec  # noqa: E402  both come with viser
import websockets.exceptions  # noqa: E402
import websockets.sync.client  # noqa: E402

from ik_toolkit.show.panel.panel import Panel  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:Queued a")  # viser's word on a visitor who has left

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (1.0, 1.0, 1.0), "fov": 1.0, "near": 0.01,
    "far": 100.0, "image_height": 600, "image_width": 800, "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


def connected(panel, **more):
    """A socket as the panel's page opens it."""
    url, protocol = panel.url.replace("http", "ws", 1), f"viser-v{viser.__version__}"
    return websockets.sync.client.connect(url, subprotocols=[protocol], compression=None, max_size=None, **more)


class Visitor:
    """What a browser says to the panel, without a browser. desk: what the panel holds for this visitor."""

    def __init__(self, panel):
        known = set(panel.desks)
        self.panel = panel
        self.socket = connected(panel, origin=f"http://127.0.0.1:{panel.port}")
        self.listener = threading.Thread(target=self._listen, daemon=True)
        self.listener.start()
        self.say(**CAMERA)
        assert until(lambda: set(panel.desks) - known)
        (self.id,) = set(panel.desks) - known
        self.desk = panel.desks[self.id]
        assert self.desk.worker.idle()

    def _listen(self):
        with contextlib.suppress(websockets.exceptions.ConnectionClosed):
            for _ in self.socket:
                pass

    def say(self, **message):
        self.socket.send(msgspec.msgpack.encode(message))

    def change(self, handle, value, name="value"):
        self.say(type="GuiUpdateMessage", uuid=handle._impl.uuid, updates={name: value})

    def press(self, label):
        handles = self.desk.gui._gui_input_handle_from_uuid.values()
        (button,) = [h for h in handles if getattr(h, "label", "") == label and h._impl.is_button]
        self.change(button, True)

    def drag(self, wxyz, position):
        name, owner = self.desk.stage.handles[0].gizmo.name, str(self.id)
        self.say(type="TransformControlsUpdateMessage", name=name, wxyz=wxyz, position=position, owner=owner)

    def status(self):
        return self.desk.status.content

    def leave(self):
        self.socket.close()
        assert until(lambda: self.id not in self.panel.desks)


def until(true, patience=30.0):
    """Whether something becomes true in time."""
    end = time.monotonic() + patience
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


def threads():
    return sum(thread.name == "ik panel visitor" for thread in threading.enumerate())


@pytest.fixture
def panel():
    with contextlib.closing(Panel("hydrolek_7w")) as made:
        yield made


def test_ten_visitors_at_once(panel):
    before = threads()
    visitors = [Visitor(panel) for _ in range(10)]
    for k, visitor in enumerate(visitors):
        visitor.change(visitor.desk.sliders[0], float(k))
    for k, visitor in enumerate(visitors):
        q = visitor.desk.session.robot.home.copy()
        q[0] = math.radians(k)
        shown = f"{visitor.desk.session.robot.fk(q).translation[1]:.5f}</td>"  # y of the tip, in the matrix
        assert until(lambda v=visitor, shown=shown: shown in v.desk.pose.content), k
    for visitor in visitors:
        visitor.leave()
    assert panel.desks == {} and until(lambda: threads() == before)


def nonsense(rng, visitor):
    """One message the page would never send."""
    slider, text = rng.choice(visitor.desk.sliders)._impl.uuid, visitor.desk.goals[0].xyz._impl.uuid
    odd = rng.choice([None, "x", [], {}, True, -1, 1e308, math.nan, math.inf, "nan", [1, 2], {"a": None}, "\x00" * 9])
    update = {"type": "GuiUpdateMessage", "uuid": rng.choice([slider, text])}
    handle, owner = visitor.desk.stage.handles[0], rng.choice([str(visitor.id), "", "x"])
    target = {
        "type": "TransformControlsUpdateMessage", "name": handle.gizmo.name, "owner": owner,
        "wxyz": [rng.choice([0.0, math.nan, 1e308, -1.0]) for _ in range(4)],
        "position": [rng.choice([0.0, math.inf, 1e308, 1e-308]) for _ in range(3)],
    }  # fmt: skip
    ball = {
        "type": "SceneNodeDragMessage", "phase": rng.choice(["start", "update", "end"]), "name": handle.ball.name,
        "instance_index": None, "button": "left", "modifier": None, "owner": owner,
        "start_screen_pos": (0.0, math.inf), "end_screen_pos": (math.nan, 0.0),
        **{f"{end}_position": [rng.choice([0.0, math.nan, 1e308, -1e308]) for _ in range(3)] for end in ("start", "end")},
    }  # fmt: skip
    readable = [
        ball,
        {**CAMERA, "fov": rng.choice([math.nan, -1.0, 1e308]), "look_at": (math.inf, 0.0, 0.0)},
        {**update, "updates": {"value": odd}},
        {**update, "updates": {rng.choice(["", "no_such", "value", "min", "max"]): odd}},
        {**update, "uuid": odd if isinstance(odd, str) else "?", "updates": {"value": 1}},
        target,
        {"type": "ShareUrlRequest"},
    ]
    unreadable = [
        rng.randbytes(rng.randrange(40)),
        odd,
        {"type": odd},
        {"type": "NoSuchMessage"},
        {"type": "ViewerCameraMessage", "wxyz": odd},
        {**CAMERA, "extra": 1},
        {"type": "FileTransferPart", "content": b"x"},
    ]
    message = rng.choice(readable if rng.random() < 0.96 else unreadable)
    return message if isinstance(message, bytes) else msgspec.msgpack.encode(message)


def unreadable(message):
    try:
        viser._messages.Message.deserialize(message)
    except Exception:
        return True
    return False


def harass(panel, count, seed):
    """Send invalid messages, reconnecting whenever disconnected; returns the number of disconnections."""
    rng, out = random.Random(seed), 0
    visitor = Visitor(panel)
    for _ in range(count):
        message = nonsense(rng, visitor)
        visitor.socket.send(message)
        if unreadable(message):
            visitor.listener.join(30.0)
            assert (visitor.socket.close_code, visitor.socket.close_reason) == (1007, THROWN_OUT), message
            out += 1
            visitor = Visitor(panel)
    visitor.leave()
    return out


THROWN_OUT = "this is not a message of the panel's page"


def check_alive(panel):
    """A new visitor can move a joint and solve a pose, and sees why another cannot be reached."""
    visitor = Visitor(panel)
    desk, robot = visitor.desk, visitor.desk.session.robot
    visitor.change(desk.sliders[1], 30.0)
    assert until(lambda: math.isclose(desk.session.q[1], math.radians(30.0)))
    goal = robot.fk(np.clip(desk.session.q + 0.1, robot.lower, robot.upper)).homogeneous
    xyz, rotation = desk.session.words(goal, "roll pitch yaw")
    visitor.change(desk.goals[0].xyz, xyz)
    visitor.change(desk.goals[0].rotation, rotation)
    assert until(lambda: desk.worker.idle() and desk.goals[0].rotation.value == rotation)
    visitor.press("Solve")
    assert until(lambda: "Converged" in visitor.status()), visitor.status()
    visitor.change(desk.goals[0].xyz, "9 0 0")
    visitor.press("Solve")
    assert until(lambda: "The closest pose is" in visitor.status()), visitor.status()
    visitor.leave()


@pytest.mark.parametrize("count", [150, pytest.param(1000, marks=pytest.mark.slow)])
def test_malformed_messages(panel, count, record_property, capfd):
    out = harass(panel, count, seed=0)
    record_property("note", f"{count} malformed messages, {out} of them rejected with a message")
    assert out > count // 50
    check_alive(panel)
    assert panel.desks == {} and "Traceback" not in capfd.readouterr().err


def test_values_that_are_no_numbers_are_refused_in_words(panel):
    visitor = Visitor(panel)
    q = visitor.desk.session.q.copy()
    visitor.change(visitor.desk.sliders[0], math.nan)
    assert until(lambda: "not a finite number" in visitor.status())
    visitor.drag((math.nan, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert until(lambda: "dragged target is not a valid pose" in visitor.status()), visitor.status()
    visitor.drag((1.0, 0.0, 0.0, 0.0), (1e200, 0.0, 0.0))
    assert until(lambda: "1e200" in visitor.status() or "beyond" in visitor.status()), visitor.status()
    assert np.array_equal(visitor.desk.session.q, q)
    visitor.change(visitor.desk.goals[0].xyz, "1 " * 100_000)
    visitor.press("Solve")
    assert until(lambda: "takes 3 numbers; got 100000" in visitor.status())
    visitor.change(visitor.desk.goals[0].xyz, "x" * 100_000)
    visitor.press("Solve")
    assert until(lambda: "takes 3 numbers, not" in visitor.status() and len(visitor.status()) < 2000)
    visitor.leave()


def test_leaving_in_the_middle_of_a_solve(panel, capfd):
    before = threads()
    for k in range(5):
        visitor = Visitor(panel)
        visitor.press("All solutions")
        visitor.change(visitor.desk.sliders[0], float(k))
        visitor.press("Solve")
        visitor.leave()
    assert until(lambda: threads() == before)
    check_alive(panel)
    assert "Traceback" not in capfd.readouterr().err


def test_the_panel_is_never_published_by_a_page(panel):
    visitor = Visitor(panel)
    visitor.say(type="ShareUrlRequest")
    visitor.say(type="ShareUrlDisconnect")
    check_alive(panel)
    assert panel.server._share_tunnel is None
    visitor.leave()


def test_no_files_are_taken(panel):
    """Whoever is let in may send what they like: nothing of it is kept, and no message may be large."""
    visitor = Visitor(panel)
    slider = visitor.desk.sliders[0]
    upload = {"transfer_uuid": "a", "source_component_uuid": slider._impl.uuid}
    tracemalloc.start()
    try:
        sizes = {"part_count": 100, "size_bytes": 50_000_000}
        visitor.say(type="FileTransferStartUpload", filename="x", mime_type="x", **sizes, **upload)
        for k in range(60):
            visitor.say(type="FileTransferPart", part_index=k, content=bytes(500_000), **upload)
        visitor.change(visitor.desk.sliders[1], 30.0)
        assert until(lambda: math.isclose(visitor.desk.session.q[1], math.radians(30.0)))
        assert tracemalloc.get_traced_memory()[0] < 10e6  # of 30 MB sent
    finally:
        tracemalloc.stop()
    with contextlib.suppress(websockets.exceptions.ConnectionClosed):
        visitor.change(visitor.desk.goals[0].xyz, "1" * 2**21)
    visitor.listener.join(30.0)
    assert visitor.socket.close_code == 1009  # message too big
    assert until(lambda: visitor.id not in panel.desks)
    check_alive(panel)


def test_visitors_cannot_talk_to_each_other_or_fill_the_memory(panel):
    """What viser would pass on to every page and keep for those to come is not taken."""
    visitor, other, heard = Visitor(panel), connected(panel), []
    tracemalloc.start()
    try:
        for k in range(30):
            visitor.say(type="GuiFormDirtyMessage", uuid=f"{k}" * 200_000)
            visitor.say(type="GuiFormSubmitMessage", uuid=f"{k}" * 200_000)
        visitor.change(visitor.desk.sliders[1], 30.0)
        assert until(lambda: math.isclose(visitor.desk.session.q[1], math.radians(30.0)))
        assert tracemalloc.get_traced_memory()[0] < 5e6  # of 20 MB sent
    finally:
        tracemalloc.stop()
    with contextlib.suppress(TimeoutError):
        while True:
            heard.append(len(other.recv(timeout=0.2)))
    assert sum(heard) < 50_000
    other.close()
    visitor.leave()


def resident():
    """Megabytes of memory in use."""
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 2**20


@pytest.mark.slow
def test_memory_stays_flat(panel, record_property):
    def round_of(seed):
        visitors = [Visitor(panel) for _ in range(20)]
        for visitor in visitors:
            visitor.press("All solutions")
        for visitor in visitors:
            visitor.leave()
        harass(panel, 1000, seed)
        return resident()

    first = [round_of(k) for k in range(3)][-1]
    last = [round_of(10 + k) for k in range(10)][-1]
    said = f"memory after 3 rounds of 20 visitors and 1000 malformed messages {first:.0f} MB, after 13 {last:.0f} MB"
    record_property("note", said)
    check_alive(panel)
    assert last - first < 40
