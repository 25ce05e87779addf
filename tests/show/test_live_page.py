"""The live page in a real browser, compared with Python: kinematics, solves, dragging, and names that stay text."""

import contextlib
import json
import re

import numpy as np
import pinocchio as pin
import pytest
from hostile import EVIL, arm
from robots import have_data, load, sample
from trees import mixed

import ik_toolkit as ik

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

SIX = ("panda", "ur5", "xarm7", "kinova", "z1", "hydrolek_7w")
TOLERANCE = 1e-6  # [m] and [rad] of the page, as of the toolkit
SOLVE = """([data, name, home, goals]) => {
  const robot = new arm.robot.constructor(data);
  return goals.map((tips) => {
    const { q, good, attempts } = arm.solve(robot, name, home, tips.map((T) => ({ T, turn: true })));
    return { q, good, attempts };
  });
}"""
KINEMATICS = """([data, Q]) => {
  const robot = new arm.robot.constructor(data);
  return Q.map((q) => {
    const now = robot.fk(q);
    return [now.tips, now.tips.map((_, tip) => robot.jacobian(now, tip))];
  });
}"""


@contextlib.contextmanager
def opened(browser, file, **context):
    """A live page, ready, with the network off; afterwards it has asked for nothing and nothing went wrong in it."""
    from chromium import fresh_page

    size = {"width": 800, "height": 300}  # few pixels: a software renderer draws them
    with fresh_page(browser, offline=True, **{"viewport": size, **context}) as page:
        page.goto(file.as_uri())
        still(page)
        yield page
        assert page.outside == [] and page.errors == []


def still(page):
    """Wait until nothing moves."""
    page.wait_for_selector("body[data-still='1']")


def press(page, button):
    """Click, and wait until nothing moves."""
    page.click(button)
    still(page)


@pytest.fixture(scope="module")
def hydrolek(browser, tmp_path_factory):
    """A shared page of the HydroLek, for tests that need no page of their own."""
    file = ik.view(load("hydrolek_7w")).page(tmp_path_factory.mktemp("page") / "hydrolek.html")
    with opened(browser, file) as page:
        yield page


def data_of(robot, tmp_path):
    """What a robot's page holds of it."""
    text = ik.view(robot).page(tmp_path / "page.html").read_text()
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])


def rows(T):
    """Rows of [R | p] of poses (N, 4, 4), as the page has them."""
    return np.asarray(T)[..., :3, :].reshape(*np.shape(T)[:-2], 12).tolist()


def robot_of(name):
    if name == "mixed":
        return ik.Tree.load(mixed(), tips=["left_tip", "right_tip"])
    if name == "from_left":  # the base moves against the world, and joints are passed upwards
        return ik.Robot.load(mixed(), tip="right_tip", base="left2_link")
    return load(name)


@pytest.mark.parametrize("name", "continuous_mix mimic_mix mixed from_left locked tool floating planar held".split())
def test_kinematics_are_pinocchios(hydrolek, tmp_path, name):
    robot = robot_of(name)
    rng = np.random.default_rng(5)
    Q = robot.random_q(rng, 20)
    found = hydrolek.evaluate(KINEMATICS, [data_of(robot, tmp_path), Q.tolist()])
    for q, (tips, columns) in zip(Q, found, strict=True):
        T = robot.fk(q)
        wanted = [one.homogeneous for one in (T.values() if robot.by_tip else [T])]
        assert np.allclose(tips, rows(wanted), rtol=0, atol=1e-12)
        assert np.allclose(np.swapaxes(columns, 1, 2).reshape(-1, robot.n), robot.jacobian(q), rtol=0, atol=1e-12)


def solved(page, robot, data, poses, solver="lm"):
    """How many poses (N, tips, 4, 4) the page solves from home, as Pinocchio judges it; and the most attempts it took."""
    answers = page.evaluate(SOLVE, [data, solver, robot.home.tolist(), rows(poses)])
    right = 0
    for answer, targets in zip(answers, poses, strict=True):
        q = np.array(answer["q"])
        pairs = robot.errors(q, targets) if robot.by_tip else [robot.errors(q, targets[0])]
        good = not robot.outside(q) and np.max(pairs) <= 1.001 * TOLERANCE
        assert good == answer["good"]
        right += good
    return right, max(answer["attempts"] for answer in answers)


@pytest.mark.parametrize("name", ["hydrolek_7w", "mimic_mix", "mixed"])
def test_reachable_poses_are_reached(hydrolek, tmp_path, name):
    robot = robot_of(name)
    poses = np.array(
        [
            [T.homogeneous for T in (robot.fk(q).values() if robot.by_tip else [robot.fk(q)])]
            for q in robot.random_q(np.random.default_rng(8), 40)
        ]
    )
    assert solved(hydrolek, robot, data_of(robot, tmp_path), poses)[0] == 40


@pytest.mark.slow
@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")
@pytest.mark.parametrize("name", SIX)
def test_six_robots(browser, tmp_path, name):
    robot = load(name)
    Q, poses = sample(robot, 300, seed=17)
    file = ik.view(robot).page(tmp_path / "page.html")
    assert file.stat().st_size < 1e6  # small enough to be mailed, meshes and all
    with opened(browser, file) as page:
        data = data_of(robot, tmp_path)
        found = page.evaluate(KINEMATICS, [data, Q.tolist()])
        assert np.allclose([tips for tips, _ in found], rows(poses[:, None]), rtol=0, atol=1e-12)
        assert solved(page, robot, data, poses[:, None])[0] >= 0.995 * 300


@pytest.mark.parametrize(("solver", "share"), [("lm", 1e-4), ("dls", 0.01), ("ccd", 0.01)])
def test_out_of_reach_the_closest_pose_of_all_attempts(hydrolek, tmp_path, solver, share):
    robot, T = load("planar_3r"), np.eye(4)[:3]
    closest = """([data, name, T, attempts]) => {
      const robot = new arm.robot.constructor(data);
      try { return arm.solve(robot, name, robot.home, [{ T, turn: false }], { attempts }); } catch ({ message }) { return message; }
    }"""

    def found(T, attempts=5):
        return hydrolek.evaluate(closest, [data_of(robot, tmp_path), solver, T, attempts])

    T[:2, 3] = 1.5 * robot.reach * np.array([np.cos(0.4), np.sin(0.4)])
    one = found(T.tolist())
    assert not one["good"] and found(T.ravel().tolist())["q"] == one["q"]
    assert one["position"] == pytest.approx(0.5 * robot.reach, rel=share) and not robot.outside(np.array(one["q"]))
    T[:, 3] = (3.09046559, 0.53043739, -2.41291694)  # one attempt ends less than a percent nearer than those before
    errors = [step["error"] for step in found(T.tolist(), 100)["way"]]
    assert errors[-1] == pytest.approx(min(errors), rel=1e-9)
    for wrong in (T[:2].tolist(), [*T.ravel()[:11].tolist(), None], None):
        assert "three rows of a pose, nested or as 12 finite numbers" in found(wrong)


def test_position_first_ends_where_the_toolkit_does(hydrolek, tmp_path):
    robot = load("hydrolek_7w")
    robot = robot.locked({robot.joint_names[3]: 0.3})
    data, rng = data_of(robot, tmp_path), np.random.default_rng(3)
    run = """([data, T]) => {
      const robot = new arm.robot.constructor(data);
      return arm.solve(robot, "lm", robot.home, [{ T, turn: true, first: true }], { attempts: 30 });
    }"""
    for _ in range(5):
        T = robot.fk(robot.random_q(rng)).homogeneous.copy()
        T[:3, :3] = T[:3, :3] @ pin.exp3(np.array([0.15, 0.1, 0.0]))
        found = hydrolek.evaluate(run, [data, rows(T)])
        assert found["good"] and found["position"] <= 1e-6
        ours = ik.solve(robot, T, priority="position").orientation_error
        assert found["angle"] >= 0.99 * ours - 1e-6  # the page stops at the first minimum that it finds
        near = ik.solve(robot, T, q0=np.array(found["q"]), priority="position", restarts=0)
        assert found["angle"] <= near.orientation_error + 2e-3


def state(page):
    return page.evaluate("arm.state()")


def pushed(page):
    """Push the arm through its null space until a joint has moved by 0.05; q before and after."""
    before = np.array(state(page)["q"])
    page.evaluate("document.getElementById('null').value = 0.8; document.getElementById('null').oninput()")
    page.wait_for_function("(q) => arm.state().q.some((x, k) => Math.abs(x - q[k]) > 0.05)", arg=before.tolist())
    page.evaluate("document.getElementById('null').value = 0")
    still(page)
    return before, np.array(state(page)["q"])


def drag(page, start, way, steps=4):
    """Press at pixels `start` and move by `way`."""
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(start[0] + way[0], start[1] + way[1], steps=steps)


def target(page):
    return np.array(page.evaluate("arm.targets[0].T")).reshape(3, 4)


def test_the_arm_follows_a_dragged_target(browser, tmp_path):
    robot = load("hydrolek_7w")
    with opened(browser, ik.view(robot).page(tmp_path / "page.html")) as page:
        before, T = state(page), target(page)
        assert np.allclose(T, robot.fk(robot.home).homogeneous[:3], atol=1e-12)
        drag(page, before["at"][0], (-20, -15))
        now = state(page)
        assert np.linalg.norm(target(page)[:, 3] - T[:, 3]) > 0.02 and np.array_equal(target(page)[:, :3], T[:, :3])
        assert np.allclose(robot.fk(now["q"]).homogeneous[:3], target(page), atol=1e-5)
        assert now["at"][0] == pytest.approx(np.add(before["at"][0], (-20, -15)), abs=1.0)
        assert page.inner_text("#status").startswith("Reached: ")
        page.mouse.move(now["at"][0][0] + 900, now["at"][0][1], steps=4)  # far beyond the edge of reach
        far = state(page)
        assert far["result"]["position"] > 0.1 and robot.outside(np.array(far["q"])) == []
        assert page.inner_text("#status").startswith("Off by ")
        page.mouse.up()
        still(page)
        assert "attempts" in page.inner_text("#status")
        wanted = np.vstack([target(page), [0, 0, 0, 1]])
        now = state(page)
        assert robot.errors(np.array(now["q"]), wanted)[0] == pytest.approx(now["result"]["position"], rel=1e-9)


def test_rings_turn_and_arrows_move_along_their_axis(hydrolek):
    page = hydrolek
    spot = """([what, k, at]) => { // pixels of a point on a handle
      const { robot } = arm, T = arm.targets[0].T, size = 0.16 * robot.reach, axis = (k) => [T[k], T[4 + k], T[8 + k]];
      const p = [T[3], T[7], T[11]].map((x, i) => x + (what === "move" ? at * axis(k)[i]
        : 0.72 * (Math.cos(at) * axis((k + 1) % 3)[i] + Math.sin(at) * axis((k + 2) % 3)[i])) * size);
      return arm.pixels(p);
    }"""
    press(page, "#home")
    T = target(page)
    drag(page, page.evaluate(spot, ["move", 2, 0.7]), (25, 5))
    page.mouse.up()
    still(page)
    moved = target(page)[:, 3] - T[:, 3]
    assert abs(moved @ T[:, 2]) > 0.005 and np.linalg.norm(np.cross(moved, T[:, 2])) < 1e-12
    T = target(page)
    drag(page, page.evaluate(spot, ["turn", 0, 0.9]), (12, 25))
    page.mouse.up()
    still(page)
    turn = T[:, :3].T @ target(page)[:, :3]
    assert np.allclose(turn[0], (1, 0, 0), atol=1e-12) and turn[1, 1] < 0.999
    assert np.allclose(target(page)[:, 3], T[:, 3], atol=1e-12)


def test_a_target_dropped_outside_the_picture_is_brought_into_it(hydrolek):
    page = hydrolek
    press(page, "#home")
    drag(page, state(page)["at"][0], (0, -400))
    assert state(page)["at"][0][1] < 0
    page.mouse.up()
    still(page)
    assert 0 < state(page)["at"][0][1] < 300
    press(page, "#home")


def test_the_camera_follows_a_robot_on_a_rail(browser, tmp_path):
    robot = ik.Robot.load("planar_2r", on_base="rail", base_limits=(0.0, 30.0))
    with opened(browser, ik.view(robot).page(tmp_path / "page.html")) as page:
        size = [page.locator("#picture").bounding_box()[side] for side in ("width", "height")]
        for _ in range(2):
            press(page, "#random")
            assert (np.abs(np.divide(state(page)["at"][0], size) - 0.5) < 0.5).all()


def test_a_race_out_of_reach_says_so(hydrolek):
    page = hydrolek
    page.evaluate("arm.targets[0].T.splice(3, 1, 99)")
    press(page, "#race")
    assert not any(run["good"] for run in state(page)["race"])
    assert page.inner_text("#status") == "No solver reached the target; it may be out of reach"
    press(page, "#home")


def test_panel(hydrolek):
    page, robot = hydrolek, load("hydrolek_7w")
    press(page, "#home")
    assert np.allclose(state(page)["q"], robot.home)
    page.locator("#joints input").nth(1).fill("0.3")
    q = np.array(state(page)["q"])
    assert q[1] == pytest.approx(0.3) and np.allclose(target(page), robot.fk(q).homogeneous[:3], atol=1e-12)
    press(page, "#random")
    assert state(page)["result"]["good"] and page.inner_text("#status").startswith("Reached: ")
    page.evaluate(
        "() => { const draw = arm.renderer.draw.bind(arm.renderer);"
        " arm.renderer.draw = (...args) => { window.robots = args[3]; draw(...args); }; }"
    )
    page.select_option("#solver", "dls")
    page.click("#race")
    page.wait_for_selector("#row-pid:visible")
    still(page)
    race = state(page)["race"]
    solid, *ghosts = page.evaluate("robots")  # the robot of the chosen solver is solid
    assert np.allclose(solid["frames"], race[1]["now"]["frames"], atol=1e-12) and solid.get("color") is None
    assert len(ghosts) == 4 and all(ghost["color"] for ghost in ghosts)
    assert [run["name"] for run in race] == ["lm", "dls", "transpose", "ccd", "pid"]
    assert race[0]["good"] and race[1]["good"] and max(run["attempts"] for run in race) > 1  # restarts count
    for run in race:
        assert run["now"]["tips"][0] == pytest.approx(robot.fk(run["q"]).homogeneous[:3].ravel().tolist(), abs=1e-9)
    assert page.inner_text("#status") == "All solvers from home, with restarts"
    assert page.locator("tr:visible").count() == 6 and len(page.get_attribute("#curve-lm", "points").split()) > 2
    T = target(page)
    press(page, "#other")
    assert np.array_equal(target(page), T)
    assert state(page)["race"] is None and page.locator("tr:visible").count() == 0
    assert page.locator("#null").is_disabled()  # six joints, rank 6
    page.select_option("#solver", "lm")
    page.uncheck("#turn")
    still(page)
    assert page.locator("#null").is_enabled()
    _, after = pushed(page)
    assert np.allclose(robot.fk(after).translation, T[:, 3], atol=2e-6)
    page.check("#turn")


def test_self_motion_is_offered_by_the_rank_of_the_jacobian(browser, tmp_path):
    """Three parallel joints have three rows for a position, and rank 2."""
    robot = load("planar_3r")
    with opened(browser, ik.view(robot).page(tmp_path / "page.html")) as page:
        assert page.locator("#null").is_enabled()
        before, after = pushed(page)
        assert np.allclose(robot.fk(after).translation, robot.fk(before).translation, atol=2e-6)
        page.check("#turn")  # the angle is the third direction
        still(page)
        assert page.locator("#null").is_disabled()


def test_two_fingers_zoom_and_the_wheel_too(hydrolek):
    page = hydrolek
    fingers = """(gap) => { // a second finger that is put down or moved this far from the first
      const canvas = document.getElementById("picture");
      const send = (type, pointerId, offsetX) => canvas[`on${type}`]({ pointerId, offsetX, offsetY: 60, pointerType: "touch" });
      canvas.setPointerCapture = () => {};
      if (!gap) { send("pointerup", 1, 0); send("pointerup", 2, 0); return; }
      if (gap === 40) { send("pointerdown", 1, 30); send("pointerdown", 2, 70); }
      send("pointermove", 2, 30 + gap);
    }"""
    apart = "Math.hypot(...arm.pixels([0, 0, 0.5]).map((x, k) => x - arm.pixels([0, 0, 0])[k]))"
    before = page.evaluate(apart)
    page.evaluate(fingers, 40)
    page.evaluate(fingers, 60)
    page.evaluate(fingers, 0)
    wide = page.evaluate(apart)
    assert wide > 1.2 * before
    page.mouse.move(100, 100)
    page.mouse.wheel(0, 300)
    page.wait_for_timeout(100)
    assert page.evaluate(apart) < wide


def test_several_tips_each_have_a_target(browser, tmp_path):
    robot = load("two_arms")
    file = ik.view(robot).page(tmp_path / "page.html")
    with opened(browser, file, viewport={"width": 420, "height": 500}, has_touch=True) as page:
        before = state(page)
        still_there = robot.fk(robot.home)[robot.tips[0]].homogeneous
        drag(page, before["at"][1], (4, -8))
        page.mouse.up()
        still(page)
        now = robot.fk(state(page)["q"])
        assert state(page)["result"]["good"]
        assert np.allclose(now[robot.tips[0]].homogeneous, still_there, atol=1e-5)
        assert np.linalg.norm(now[robot.tips[1]].translation - robot.fk(robot.home)[robot.tips[1]].translation) > 0.01
        assert page.evaluate("document.documentElement.scrollWidth") <= 420


def test_names_stay_text(browser, tmp_path):
    robot = ik.Robot.load(arm())
    file = ik.view(robot).page(tmp_path / "page.html")
    text = file.read_text()
    plain = ik.view(load("planar_2r")).page(tmp_path / "plain.html").read_text()
    assert re.findall(r"<\w+", text) == re.findall(r"<\w+", plain)  # no element but the page's own
    with opened(browser, file) as page:
        assert page.title() == robot.name
        assert page.locator("#joints span").all_inner_texts() == list(EVIL)
        assert page.locator("img, object, b").count() == 0
