"""What results say of themselves in a cell of a notebook and in a terminal: a table that fits, and where its plot is."""

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.solvers.status import Status
from ik_toolkit.text import TextTable

ROBOT = "hydrolek_7w"


@pytest.fixture(scope="module")
def robot():
    return ik.Robot.load(ROBOT)


@pytest.fixture(scope="module")
def poses(robot):
    return np.array([robot.fk(robot.random_q(np.random.default_rng(k))).homogeneous for k in range(40)])


def test_a_table_is_as_long_as_a_cell_and_says_what_is_left_out():
    table = TextTable("40 rows", "of <numbers>", ("k", "x"), [(k, k / 3) for k in range(40)], "note", "")
    page = table.html()
    assert page.count("<tr>") == 13 and "<th>x</th>" in page and "<td>0.3333</td>" in page
    assert "of &lt;numbers&gt;" in page and "and 28 more rows" in page and page.endswith("<div>note</div>")
    lines = str(table).splitlines()
    assert lines[0] == "40 rows of <numbers>" and lines[1] == "k   x" and lines[3] == "1   0.3333"
    assert lines[-2:] == ["and 28 more rows", "note"]
    assert str(TextTable("empty", "", ("a",), [])).splitlines() == ["empty", "a"]


def test_a_batch_counts_what_ended_how(robot, poses):
    batch = ik.solve_batch(robot, poses, "dls", restarts=0, max_iterations=7)
    page = batch._repr_html_()
    for name, count in batch.counts().items():
        assert f"<td>{name}</td><td>{count}</td><td>{100 * count / 40:.1f}&nbsp;%</td>" in page
    assert len(batch.counts()) > 1 and batch.success.any()
    good = batch.iterations[batch.status == Status.CONVERGED]
    assert f"<td>{np.median(good):g}</td>" in page and "ik.plot(batch)" in page
    assert "of 0 targets" in ik.solve_batch(robot, poses[:0])._repr_html_()


def test_solutions_are_listed_by_joint(robot):
    arm = ik.Robot.load("planar_2r")
    found = ik.solve_all(arm, (1.0, 0.5, 0.0))
    page = found._repr_html_()
    assert len(found) == 2 and page.count("<tr>") == 3 and "2 solutions" in page
    assert all(f"<td>{x:.4f}</td>" in page for x in found.q.ravel()) and "joint_1" in page
    assert "0 solutions" in ik.solve_all(arm, (9.0, 0.0, 0.0))._repr_html_()


def test_paths_and_trajectories(robot, poses):
    line = np.tile(robot.fk(robot.home).homogeneous, (9, 1, 1))
    line[:, 0, 3] -= np.linspace(0.0, 0.05, 9)
    path = ik.solve_path(robot, line)
    page = path._repr_html_()
    assert "FOLLOWED" in page and f"{path.length[0]:.4g}&nbsp;rad" in page and "ik.plot(result)" in page
    trajectory = path.retime(acceleration=1.0)
    page = trajectory._repr_html_()
    assert page.count("<tr>") == 1 + robot.n and "azimuth_yaw" in page and f"{trajectory.duration:.4g} s" in page
    line[-1, 0, 3] = 9.0
    lost = ik.solve_path(robot, line)._repr_html_()
    assert "INCOMPLETE" in lost and "9,&nbsp;not&nbsp;reached:&nbsp;1" in lost


def test_studies_are_tables_in_terminals_too(robot):
    found = ik.benchmark([robot, "planar_3r"], ["lm", "dls"], targets=20)
    lines = repr(found).splitlines()
    assert len(lines) == 7 and max(map(len, lines)) < 160 and lines[2].startswith("hydrolek_7w  lm")
    assert found._repr_html_().count("<tr>") == 5
    studied = ik.workspace(robot, ["lm", "dls"], targets=100)
    assert len(repr(studied).splitlines()) == 5 and studied._repr_html_().count("<tr>") == 3


def test_plots_are_one_call_away(robot, poses, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
    batch = ik.solve_batch(robot, poses, "dls", restarts=0, max_iterations=7)
    (axis,) = ik.plot(batch, file=tmp_path / "batch.png").axes
    (curve,) = axis.lines
    assert curve.get_ydata().max() == pytest.approx(100 * batch.success.mean())
    assert "off" in axis.get_title(loc="left")
    found = ik.solve_all(ik.Robot.load("planar_2r"), (1.0, 0.5, 0.0))
    assert len(ik.plot(found).axes[0].lines) == 2
    ik.plot(ik.solve_batch(robot, poses[:0]))
