"""The panel without a browser: sessions, updates sent to the page, and access control."""

import contextlib
import http.client
import json
import logging
import socket
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from robots import CONTINUOUS, FORK, have_data

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, InvalidTarget, RobotNotFound
from ik_toolkit.show.panel.session import Session

ROBOT = "hydrolek_7w"  # of the panel, see conftest.py
DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")


# ------------------------------------------------------------------------------------------------------------ session
def test_typed_pose_is_read_back():
    session = Session("hydrolek_7w")
    T = session.robot.fk(session.robot.random_q(np.random.default_rng(0))).homogeneous
    for kind in ("roll pitch yaw", "quaternion"):
        for degrees in (True, False):
            session.degrees = degrees
            xyz, rotation = session.words(T, kind)
            assert np.allclose(session.typed(xyz, kind, rotation), T, atol=2e-5)
    assert np.allclose(session.typed("1, 2 3", "free", "nonsense"), [1, 2, 3])


@pytest.mark.parametrize(
    ("xyz", "kind", "rotation", "words"),
    [
        ("1 2", "free", "", "the position x y z .* takes 3 numbers; got 2"),
        ("1 2 x", "free", "", "not '1 2 x'"),
        ("1 2 3", "roll pitch yaw", "1", r"roll pitch yaw \[deg\] takes 3 numbers; got 1"),
        ("1 2 3", "quaternion", "0 0 0 0", "not a rotation"),
        ("1 2 nan", "free", "", "finite"),
    ],
)
def test_bad_typed_input_is_refused_in_words(xyz, kind, rotation, words):
    with pytest.raises(InvalidTarget, match=words):
        Session("hydrolek_7w").typed(xyz, kind, rotation)


def test_a_solve_moves_the_robot_and_a_failure_goes_to_the_closest_pose():
    session = Session("hydrolek_7w")
    goal = session.robot.fk(session.robot.random_q(np.random.default_rng(1))).homogeneous
    assert session.solve(goal).success and np.allclose(session.poses()["tool"], goal, atol=1e-5)
    far = goal.copy()
    far[0, 3] = 9.0
    result = session.solve(far)
    assert not result.success and dict(session.figures())["status"] == "UNREACHABLE"
    left = np.linalg.norm(session.poses()["tool"][:3, 3] - far[:3, 3])
    assert session.followed.settled and left < result.position_error + 1e-9
    assert not any(session.follow(far).errors["tool"][0] < 0.99 * left for _ in range(5))  # a drag gets no closer
    session.solve(np.array([1e9, 0.0, 0.0]))  # too far for a drag: the attempt is shown
    assert session.followed is None and np.array_equal(session.q, session.result.q)


def test_parameters_go_to_the_solver():
    session = Session("hydrolek_7w")
    session.solver = "dls"
    assert session.fields() == {"damping": 0.03, "hold": True}
    session.parameters = {"damping": "0.5", "hold": "False"}
    assert session.rule() == ik.DLS(damping=0.5, hold=False)
    for text, words in (("a b", "takes a number or a list"), ("fast", "takes a number")):
        session.parameters = {"damping": text}
        with pytest.raises(InvalidOption, match=words):
            session.solve(session.poses()["tool"])
    session.solver, session.parameters = "pid", {"kp": "[1, 1, 1, 1, 1, 1]"}
    assert len(session.rule().kp) == 6


def test_choices_leave_out_closed_forms_that_do_not_fit():
    assert "inspection" in Session("inspection_7dof").choices()
    names = Session("hydrolek_7w").choices()
    assert names[:2] == ["auto", "lm"] and not {"inspection", "planar-2r"} & set(names)


def test_all_solutions_are_kept_nearest_first():
    session = Session("planar_2r")
    words, details = session.solve_all(session.robot.fk(session.q).translation)
    assert words == "2 solutions; these are all" and "branches" in details and len(session.solutions) == 2
    assert "no solution" in session.solve_all(np.array([9.0, 0, 0]))[0] and session.solutions == []


def test_switching_keeps_everything_when_it_fails():
    session = Session("hydrolek_7w")
    robot = session.robot
    with pytest.raises(RobotNotFound):
        session.load("no_such_robot")
    assert session.robot is robot and session.source == "hydrolek_7w"
    session.load("brokk_hydrolek")
    assert session.robot.tips == session.tips == ("left_tip", "right_tip")
    session.load("brokk_hydrolek", "right_tip")
    assert session.robot.tip == "right_tip"


def test_a_file_with_several_tips_starts_with_one(tmp_path):
    file = tmp_path / "fork.urdf"
    file.write_text(FORK)
    session = Session(str(file))
    assert session.tips == ("b", "c") and session.robot.tip == "b"


def test_the_table_of_joint_axes_at_home():
    import pinocchio as pin

    for name in ("brokk_hydrolek", "palletizer"):  # two joints of the palletizer only shift the tip, by their followers
        robot = (session := Session(name)).robot
        rows = session.axes()
        assert len(rows) == robot.n
        pin.forwardKinematics(robot.model, data := robot.model.createData(), robot.to_pinocchio(robot.home))
        for joint, _, *line in rows:
            place, S = (of[robot.model.getJointId(joint)] for of in (data.oMi, data.joints))
            w, through = ([float(x) for x in text.split()] for text in line)
            assert np.linalg.norm(np.cross(place.translation - through, w)) < 1e-3, joint
            assert np.allclose(place.rotation @ np.ravel(S.S)[3:], w, atol=1e-3)


def test_json_is_plain_numbers():
    session = Session("planar_3r")
    session.solve(session.robot.fk(session.robot.home).translation)
    made = json.loads(session.to_json())
    assert made["joint_names"] == list(session.robot.joint_names) and made["result"]["success"]
    assert np.allclose(made["T_base_tip"], session.poses()["tool"])


def test_continuous_joints_have_a_turn_of_slider(tmp_path):
    file = tmp_path / "c.urdf"
    file.write_text(CONTINUOUS)
    session = Session(str(file))
    low, high = session.ends(0)
    assert np.isclose(high - low, 2 * np.pi) and session.unit(0) == "deg"
    session.degrees = False
    assert session.unit(0) == "rad" and session.scale(0) == 1.0


# --------------------------------------------------------------------------------------------------------- the server
viser = pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")


OPENING = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}  # fmt: skip


def asked(panel, path=None, **headers):
    at = urlsplit(panel.url)
    with contextlib.closing(http.client.HTTPConnection(at.hostname, panel.port, timeout=10)) as client:
        client.request("GET", at.path if path is None else path, headers=headers)
        answer = client.getresponse()
        return answer.status, answer.read().decode(errors="replace")


def test_only_its_own_page_may_use_it(panel):
    here = f"127.0.0.1:{panel.port}"
    assert panel.server.get_host() == "127.0.0.1"
    assert asked(panel)[0] == 200
    assert asked(panel, Origin=f"http://{here}")[0] == 200
    status, words = asked(panel, Origin="http://elsewhere.example")
    assert status == 403 and "other sites" in words
    assert asked(panel, Origin="http://elsewhere.example", **OPENING)[0] == 403
    status, words = asked(panel, Host=f"rebound.example:{panel.port}")
    assert status == 403 and "rebound.example" in words


def test_knocking_at_the_port_is_not_said(panel, caplog):
    """Neither who lacks the token nor who speaks no HTTP fills the terminal of whoever runs the panel."""
    assert asked(panel, "/nothing")[0] == 403
    for words in (b"POST / HTTP/1.1\r\n\r\n", b"\x16\x03\x01" + bytes(50), b""):
        with socket.create_connection(("127.0.0.1", panel.port), timeout=10) as knocking:
            knocking.sendall(words)
            knocking.shutdown(socket.SHUT_WR)
            knocking.recv(1000)
    assert asked(panel)[0] == 200
    assert [record.message for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_without_the_token_there_is_nothing_to_see(panel):
    """Nor may another account of the same machine, which can reach the port, drive the panel or read what it serves."""
    token = urlsplit(panel.url).path.strip("/")
    assert len(token) >= 20
    other = token[:-1] + ("A" if token[-1] != "A" else "B")
    bad = ["/", "", "//", "/index.html", f"/{token}x/", f"/{token[:-1]}/", f"/{other}/", f"//{token}/"]
    bad += [f"/{other}/../{token}/", f"/?{token}", f"/%2f{token}/", f"/{token.swapcase()}/", f"/{'x' * 5000}/", "/%ff/"]
    for path in bad:
        for headers in ({}, OPENING):
            status, words = asked(panel, path or "/", **headers)
            assert status == 403 and "whole address" in words and token not in words, path
    assert asked(panel)[0] == asked(panel, f"/{token}/index.html")[0] == asked(panel, f"/{token}/?x=1")[0] == 200
    assert asked(panel, f"/{token}/no_such_file")[0] == 404 and asked(panel, f"/{token}/../../etc/hostname")[0] == 404


def test_a_taken_port_is_refused(panel):
    from ik_toolkit.show.panel.panel import Panel

    with pytest.raises(InvalidOption, match=f"port {panel.port} is in use"):
        Panel("hydrolek_7w", port=panel.port)
    with pytest.raises(RobotNotFound):
        Panel("no_such_robot")
    for host in ("203.0.113.7", "no host"):  # an address kept for examples: never this machine's
        with pytest.raises(InvalidOption, match=f"cannot listen on {host}"):
            Panel("hydrolek_7w", host=host)


def test_other_addresses(run, monkeypatch):
    from ik_toolkit.show.panel.panel import Panel

    with contextlib.closing(Panel("planar_2r", host="127.0.0.2")) as made:
        assert asked(made)[0] == 200 and made.url.startswith("http://127.0.0.2:")
    monkeypatch.setattr("ik_toolkit.cli.view.wait", lambda words, url, browse: print(words))
    code, out, err = run("panel", "planar_2r", "--host", "0.0.0.0", "--no-open")
    assert code == 0 and "anyone who knows the address" in err and "http://127.0.0.1:" in out
    code, _, err = run("panel", "planar_2r", "--no-open")
    assert code == 0 and "anyone" not in err


def test_moving_a_slider_moves_what_is_drawn(desk):
    robot = desk.session.robot
    slider = desk.sliders[1]
    slider.value = 30.0
    before = desk.session.q.copy()
    desk._moved()
    assert np.isclose(desk.session.q[1], np.radians(30.0)) and np.array_equal(desk.session.q[2:], before[2:])
    T = robot.fk(desk.session.q)
    assert np.allclose(desk.stage.tips[0].position, T.translation, atol=1e-9)
    for handle, M in zip(desk.stage.parts, desk.stage.body.placements(desk.session.q), strict=True):
        assert np.allclose(handle.position, M[:3, 3], atol=1e-9)
    assert f"{T.translation[0]:.5f}" in desk.pose.content


def test_the_camera_shows_the_robot_as_large_as_fits():
    """All corners are seen, none further out than the share that the robot may fill, and one of them that far."""
    from ik_toolkit.show.panel.viser_scene import PICTURE, camera_for

    box = np.array([[-0.2, -0.5, 0.0], [0.9, 0.4, 1.3]])
    for aspect, free in ((1.1, 1.0), (2.5, 1.0), (0.5, 0.5)):
        eye, to = camera_for(box, PICTURE.view, aspect, free)
        ahead = (to - eye) / np.linalg.norm(to - eye)
        across = np.cross(ahead, (0, 0, 1)) / np.linalg.norm(np.cross(ahead, (0, 0, 1)))
        P = np.array(np.meshgrid(*box.T)).reshape(3, -1).T - eye
        seen = P @ np.array([across, np.cross(across, ahead)]).T / (P @ ahead)[:, None] / np.tan(PICTURE.lens / 2)
        x, y = seen[:, 0] / aspect, (seen[:, 1] - (1.0 - free)) / free  # of the part that is free
        assert np.isclose(max(np.abs(x).max(), np.abs(y).max()), PICTURE.fill, atol=0.12) and abs(y).max() < 0.9


def test_limits_are_shown_rounded(desk):
    assert all(round(edge, 2) == edge for slider in desk.sliders for edge in (slider.min, slider.max))
    desk.session.q = desk.session.robot.upper.copy()  # beyond what the slider shows, and kept
    desk.show()
    desk._moved()
    assert np.array_equal(desk.session.q, desk.session.robot.upper)


def test_solving_a_typed_pose(desk):
    goal = desk.session.robot.fk(desk.session.robot.random_q(np.random.default_rng(2))).homogeneous
    desk.goals[0].xyz.value, desk.goals[0].rotation.value = desk.session.words(goal, "roll pitch yaw")
    desk._guard(desk._solve)()
    assert "Converged" in desk.status.content and desk.chart.plot.visible and "CONVERGED" in desk.outcome.content
    assert np.allclose(desk.stage.tips[0].position, goal[:3, 3], atol=1e-4)
    desk.goals[0].xyz.value = "9 0 0"
    desk._guard(desk._solve)()
    assert "beyond reach" in desk.status.content and "The closest pose is" in desk.status.content
    assert "move the target" not in desk.status.content and "move the target" in desk.outcome.content
    assert np.allclose(desk.stage.lines["gap"].points[0], [desk.stage.tips[0].position, [9, 0, 0]])
    desk.goals[0].give("free")
    desk.goals[0].xyz.value = "0.9 0 0"
    desk._guard(desk._solve)()
    assert "Converged" in desk.status.content and "gap" not in desk.stage.lines
    assert np.isfinite(desk.chart.plot.data).all() and len(desk.chart.plot.data) == len(desk.chart.plot.series) == 2
    desk._dragged()
    assert not desk.chart.plot.visible  # it would show the solve before
    desk.goals[0].xyz.value = "<b>9</b>"
    desk._guard(desk._solve)()
    assert "takes 3 numbers" in desk.status.content and "<b>" not in desk.status.content
    desk.goals[0].xyz.value, desk.tolerance.value = "0.9 0 0", "much"
    desk._guard(desk._solve)()
    assert "the tolerance must be a number" in desk.status.content


def test_all_solutions_can_be_picked(desk):
    desk.goals[0].xyz.value = "9 0 0"
    desk._guard(desk._solve)()
    assert "gap" in desk.stage.lines
    desk.goals[0].give("free")
    desk.goals[0].xyz.value = desk.session.words(desk.session.poses()["tool"], "free")[0]
    desk._guard(desk._solve_all)()
    assert "gap" not in desk.stage.lines  # it led to the target before
    assert ">Infinitely many solutions.<" in desk.status.content  # one line; how they were found is said at the list
    assert "starts converged" in desk.found.table.content
    assert desk.found.folder.visible and len(desk.session.solutions) > 2
    assert "elbow_pitch [deg]" in desk.found.table.content
    desk.found.number.value = 3
    desk.found.point()
    where = desk.stage.body.placements(desk.session.solutions[2])[-1][:3, 3]
    assert np.allclose(desk.stage.shade[-1].position, where) and desk.stage.shade[-1].visible
    desk._pick(desk.found.chosen)
    assert np.array_equal(desk.session.q, desk.session.solutions[2]) and "solution 3" in desk.status.content
    assert not desk.stage.shade[-1].visible


def test_switching_robot_units_and_home(desk):
    desk._guard(lambda: desk._switch("planar_3r"))()
    assert len(desk.sliders) == 3 and "planar_3r" in desk.status.content
    assert "[deg]" in desk.sliders[0].label
    desk._units(False)
    assert "[rad]" in desk.sliders[0].label
    desk.session.q = desk.session.robot.home + 0.1
    desk._home()
    assert np.array_equal(desk.session.q, desk.session.robot.home)
    desk._guard(lambda: desk._switch("planar_4r"))()
    assert "there is no robot" in desk.status.content and len(desk.sliders) == 3
    desk.files = False
    desk._guard(lambda: desk._switch("/etc/hostname"))()
    assert "by name only" in desk.status.content


@DATA
def test_robots_of_the_data_package_are_offered(desk):
    desk._guard(lambda: desk._switch("xarm7"))()
    assert len(desk.sliders) == 7 and len(desk.stage.parts) == 8


def test_desks_do_not_share_a_robot(panel, desk):
    from ik_toolkit.show.panel.page import PanelPage

    other = PanelPage(panel.server, "hydrolek_7w")
    assert other.worker.idle()
    desk.session.q = desk.session.q + 0.01
    assert not np.array_equal(desk.session.q, other.session.q)
    other.close()


def test_a_worker_does_the_newest_and_survives():
    from ik_toolkit.show.panel.connection import Worker

    worker, done, gate = Worker(), [], threading.Event()
    worker.post("wait", gate.wait)
    time.sleep(0.05)
    for k in range(50):
        worker.post("drag", lambda k=k: done.append(k))
    worker.post("other", lambda: done.append("other"))
    gate.set()
    assert worker.idle() and done == [49, "other"]
    worker.end()


def test_refusals_by_header():
    from websockets.datastructures import Headers

    from ik_toolkit.show.access import is_loopback, refused_request

    assert is_loopback("127.0.0.1") and is_loopback("localhost") and is_loopback("::1") and not is_loopback("0.0.0.0")
    assert refused_request({"Host": "localhost:1"}, "127.0.0.1") == ""
    assert "only" in refused_request({"Host": "evil.example:1"}, "127.0.0.1")
    assert "only" in refused_request({"Host": "localhost:1, evil.example:1"}, "127.0.0.1")
    assert refused_request({"Host": "arm.example:1", "Origin": "http://arm.example:1"}, "0.0.0.0") == ""
    assert "other sites" in refused_request({"Host": "arm.example:1", "Origin": "http://evil.example"}, "0.0.0.0")
    host, origin = ("Host", "localhost:1"), ("Origin", "http://localhost:1")
    assert refused_request(Headers([host, origin]), "127.0.0.1") == ""
    for twice in ([host, ("host", "evil.example"), origin], [host, origin, ("origin", "http://evil.example")]):
        assert "more than one header" in refused_request(Headers(twice), "127.0.0.1")
