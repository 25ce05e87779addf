"""Names come from untrusted files: every page and chart treats them as text only."""

import contextlib
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hostile import EVIL, Reader, arm

import ik_toolkit as ik
from ik_toolkit.robot.joints import Joints
from ik_toolkit.solvers.result import Result
from ik_toolkit.text import Tabled

TAGS = {"img", "script", "b", "object"}


@pytest.fixture(scope="module")
def robot():
    made = ik.Robot.load(arm())
    assert set(made.joint_names) == set(EVIL)
    return made


def check(page, *, tags=(), handlers=0, says=()):
    """No element and no handler but ours; the names are there as text."""
    seen = Reader(page)
    assert not (TAGS - set(tags)) & set(seen.tags), seen.tags
    assert len(seen.handlers) == handlers, seen.handlers
    for words in says:
        assert words in seen.text, words


def test_cells_of_a_notebook(robot):
    tree = ik.Tree.load(arm(), tips=[robot.tip, f"3 {EVIL[3]}"])
    target = robot.fk(robot.random_q(np.random.default_rng(0)))
    for result in (ik.solve(robot, target), ik.solve(robot, (9.0, 0.0, 0.0))):
        check(result._repr_html_(), tags=["b"], says=EVIL)
    blocked = ik.solve(robot, robot.fk(robot.upper), "dls", q0=robot.lower, restarts=0, max_iterations=3)
    check(blocked._repr_html_(), tags=["b"], says=EVIL)
    for shown in (robot, tree):
        check(shown._repr_html_(), tags=["b"], says=EVIL)
    made = ik.solve(tree, tree.fk(tree.home))
    check(made._repr_html_(), tags=["b"], says=tree.joint_names)


def test_every_class_with_html_of_its_own_is_looked_at_here():
    pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
    from ik_toolkit.show.scene import Scene
    from ik_toolkit.solvers.batch.result import BatchResult
    from ik_toolkit.solvers.solutions import Solutions
    from ik_toolkit.study.benchmark import Benchmark
    from ik_toolkit.study.place import Placements
    from ik_toolkit.study.workspace import Workspace

    results = {BatchResult, Solutions, Benchmark, Workspace, ik.PathResult, ik.Trajectory}
    results |= {ik.Calibration, ik.ReachabilityMap, Placements}
    public = {c for c in vars(ik).values() if isinstance(c, type)} | {Joints, Result, Scene} | results
    own = {c for c in public if "_repr_html_" in vars(c) or issubclass(c, Tabled)}
    assert own == {Joints, Result} | results


def test_tables_of_results(robot):
    """Those of robots with names that are no text of ours; Solutions and Trajectory name joints, the others the robot."""
    robot.name = EVIL[0]
    poses = robot.chain.forward(robot.random_q(np.random.default_rng(0), 3))[0]
    line = np.tile(robot.fk(robot.home).homogeneous, (5, 1, 1))
    line[:, 0, 3] += np.linspace(0.0, 0.01, 5)
    path = ik.solve_path(robot, line)
    made = {
        ik.solve_batch(robot, poses): EVIL[:1],
        ik.solve_all(robot, poses[0], starts=8): EVIL,
        path: (),
        path.retime(1.0, acceleration=1.0): EVIL,
    }
    for result, says in made.items():
        check(result._repr_html_(), tags=["b"], says=says)
    for study in (ik.benchmark(robot, "lm", targets=3), ik.workspace(robot, targets=20)):
        check(study._repr_html_(), tags=["b"], says=EVIL[:1])


def test_tables_of_maps_places_and_calibrations(robot):
    robot.name = EVIL[0]
    T = np.tile(robot.fk(robot.home).homogeneous, (3, 1, 1))
    box = (T[0, :3, 3] - 0.05, T[0, :3, 3] + 0.05)
    check(ik.reachability(robot, box, resolution=0.05, audit=0)._repr_html_(), tags=["b"], says=EVIL[:1])
    check(ik.place(robot, T, count=1)._repr_html_(), tags=["b"], says=EVIL[:1])
    Q = robot.random_q(np.random.default_rng(4), 12)
    measured = robot.chain.forward(Q)[0][:, :3, 3]
    check(ik.calibrate(robot, Q, measured, parameters=("joints",))._repr_html_(), tags=["b"])


def test_scenes(robot, tmp_path):
    pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
    pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")
    target = robot.fk(robot.random_q(np.random.default_rng(1)))
    scene = ik.view(robot, ik.solve(robot, target, history=True), target=target)
    page = scene.save(tmp_path / "scene.html").read_text()
    plain = Reader(ik.view(ik.Robot.load("planar_2r")).html())
    seen = Reader(page)
    assert seen.tags == plain.tags and seen.handlers == plain.handlers == []
    assert page.count('still("') == 1 and robot.name in seen.text
    assert Reader(scene._repr_mimebundle_()["text/html"]).tags == ["div", "img", "script"]


def test_the_panel(robot, tmp_path):
    viser = pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
    pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")
    from ik_toolkit.show.panel.page import PanelPage
    from ik_toolkit.show.panel.panel import Panel

    file = tmp_path / "<img src=x onerror=alert(4)>.urdf"
    file.write_text(arm())
    with contextlib.closing(Panel(str(file))) as panel:
        desk = PanelPage(panel.server, str(file))
        assert desk.worker.idle()
        desk.say("".join(EVIL))
        pages = [desk.status.content]
        for target in (robot.fk(robot.home), robot.fk(robot.upper)):
            desk.goals[0].put(target.homogeneous)
            desk._guard(desk._solve)()
            pages += [desk.status.content, desk.outcome.content, desk.pose.content]
        for source in (EVIL[0].replace("<", ""), f"nowhere/{EVIL[1][3:]}", EVIL[0]):  # the last is taken for a URDF
            desk._guard(lambda source=source: desk._switch(source))()
            pages.append(desk.status.content)
        assert "onerror=alert(1)" in pages[-3] and "&lt;" in pages[-2] and "not well-formed" in pages[-1]
        desk.goals[0].xyz.value = EVIL[0]
        desk._guard(desk._solve)()
        pages.append(desk.status.content)
        assert "onerror=alert(1)" in pages[-1]
        handles = [h for c in desk.gui._container_handle_from_uuid.values() for h in c._children.values()]
        assert not any(isinstance(h, viser.GuiMarkdownHandle) for h in handles)
        table = [h.content for h in handles if isinstance(h, viser.GuiHtmlHandle)]
        assert sum(EVIL[0] in Reader(page).text for page in table) >= 1
        for page in pages + table:
            check(page)
        desk._json()
        desk.close()


def test_charts(tmp_path):
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
    from ik_toolkit.show import plots

    evil = "$\\frac{1$ <b>"
    robot = ik.Robot.load(arm([f"{evil}{k}" for k in range(6)]))
    target = robot.fk(robot.random_q(np.random.default_rng(2)))
    result = ik.solve(robot, target, "lm", history=True)
    run = ik.track(robot, ik.circle(robot.fk(robot.home).translation, 0.02, duration=1.0), dt=0.05, q0=robot.home)
    run.robot, run.method = evil, evil
    figures = [
        plots.convergence({evil: result}, title=evil),
        plots.tracking_errors({evil: run}),
    ]
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # letters as letters, so that they can be read back
        pages = [plots.save(figure, tmp_path / f"{k}.svg") for k, figure in enumerate(figures)]
        ik.plot(run, robot, file=tmp_path / "track.svg")
        pages.append(tmp_path / "track.svg")
    for page in pages:
        drawn = ET.parse(page)
        assert {element.tag.partition("}")[2] for element in drawn.iter()}.isdisjoint(TAGS)
        words = " ".join("".join(element.itertext()) for element in drawn.iter() if element.tag.endswith("text"))
        assert evil in words, page
