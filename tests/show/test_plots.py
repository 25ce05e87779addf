"""Charts: they draw the given numbers, leave no figure open, and reject what they cannot draw."""

import numpy as np
import pytest
from robots import CONTINUOUS, load

import ik_toolkit as ik
from ik_toolkit.errors import ConfigurationNotFound, InvalidOption
from ik_toolkit.show import plots

pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")


@pytest.fixture(autouse=True)
def nothing_stays_open():
    import matplotlib.pyplot as plt

    yield
    assert plt.get_fignums() == []


@pytest.fixture(scope="module")
def solved():
    robot = load("hydrolek_7w")
    target = robot.fk(robot.random_q(np.random.default_rng(3)))
    return {name: ik.solve(robot, target, name, history=True) for name in ("lm", "dls")}


def lines(axis):
    return {line.get_label(): np.asarray(line.get_ydata()) for line in axis.get_lines()}


def test_convergence_draws_the_history(solved):
    figure = plots.convergence(solved, title="side by side")
    assert len(figure.axes) == 2
    for axis, result in zip(figure.axes, solved.values(), strict=True):
        drawn = lines(axis)
        assert np.array_equal(drawn["position [m]"], np.maximum(result.history["position_error"], plots.FLOOR))
        assert np.array_equal(drawn["orientation [rad]"], np.maximum(result.history["orientation_error"], plots.FLOOR))
        assert axis.get_yscale() == "log"
    assert plots.convergence(solved["lm"]).axes[0].get_title(loc="left").startswith("lm: ")
    robot = load("hydrolek_7w")
    position = ik.solve(robot, robot.fk(robot.home).translation, q0=robot.upper, history=True)
    assert "orientation [rad]" not in lines(plots.convergence({"mine": position}).axes[0])


def test_a_failed_solve_shows_the_attempt_of_its_answer():
    robot = load("hydrolek_7w")
    # proven out of reach in three attempts; 250 attempts fail
    for target, rpy in (((0.0, 3.0, 0.0), (0.0, 0.7, 0.1)), ((0.8, 0.2, 0.3), (0.0, 0.0, 0.0))):
        result = ik.solve(robot, ik.pose(target, rpy=rpy), history=True)
        assert not result.success and result.attempt > 0
        Q, position, _, others = plots.iterates(result)
        assert np.array_equal(Q[-1], result.q)
        (won,) = np.nonzero(result.history["attempt"] == result.attempt)
        assert np.array_equal(position, result.history["position_error"][won])
        assert (np.diff(won)[:-1] == 1).all()  # the last row is the closest configuration, found after all attempts
        assert not set(np.concatenate(others)) & set(won)
        drawn = plots.convergence(result).axes[0].get_lines()
        (line,) = [line for line in drawn if line.get_label() == "position [m]"]
        assert line.get_ydata()[-1] == pytest.approx(result.position_error, rel=1e-9)
        assert len(line.get_ydata()) == len(won)
        grey = [line for line in drawn if line.get_color() == plots.COLOURS[7]]
        assert len(grey) == len(others) and all(line.get_linewidth() < 1 for line in grey)


def test_rows_of_a_history_are_told_apart_by_attempts():
    robot = load("hydrolek_7w")
    target = ik.pose((0.8, 0.2, 0.3), rpy=(0.0, 0.0, 0.0))
    whole = ik.solve(robot, target, history=True).history
    for restarts in (1, 4):
        alone = ik.solve(robot, target, history=True, restarts=restarts).history
        rows, mine = whole["attempt"] < restarts, alone["attempt"] < restarts  # the last attempt is not given up early
        for key in ("q", "position_error", "attempt"):
            same = whole[key][rows]
            assert len(same) > 1 and np.array_equal(same, alone[key][mine][: len(same)])


def test_tracking_errors_of_runs():
    robot = load("hydrolek_7w")
    path = ik.circle(robot.fk(robot.home), 0.03, duration=1.0)
    runs = {name: ik.track(robot, path, name, dt=0.02, q0=robot.home) for name in ("cv", "ca")}
    figure = plots.tracking_errors(runs)
    assert len(figure.axes) == 2 and set(lines(figure.axes[0])) == {"cv", "ca"}
    assert np.array_equal(lines(figure.axes[0])["ca"], np.maximum(runs["ca"].position_error, plots.FLOOR))


@pytest.mark.parametrize("suffix", plots.SUFFIXES)
def test_save_writes_files(tmp_path, solved, suffix):
    file = plots.save(plots.convergence(solved), tmp_path / f"chart{suffix}")
    assert file.stat().st_size > 1000


def test_refusals_are_words(tmp_path, solved):
    robot = load("hydrolek_7w")
    with pytest.raises(InvalidOption, match=r"\.png, \.pdf or \.svg"):
        plots.save(plots.convergence(solved), tmp_path / "chart.txt")
    with pytest.raises(InvalidOption, match="file must be the path of a file, not 3"):
        plots.save(plots.convergence(solved), 3)
    with pytest.raises(InvalidOption, match="history=True"):
        plots.convergence(ik.solve(robot, robot.fk(robot.home), "lm"))
    with pytest.raises(InvalidOption, match="no runs"):
        plots.convergence({})


def test_history_says_what_the_result_says():
    robot = ik.Robot.load("hydrolek_7w")
    free = ik.solve(robot, robot.fk(robot.home).translation + 0.05, history=True)
    assert np.isnan(free.history["orientation_error"]).all()
    axis = plots.convergence(free).axes[0]
    assert [line.get_label() for line in axis.lines] == ["position [m]"]
    far = np.array([9.0, 0.0, 0.0])
    lost = ik.solve(robot, far, history=True)
    assert lost.status.name == "UNREACHABLE"
    for q, error in zip(lost.history["q"], lost.history["position_error"], strict=True):
        assert abs(np.linalg.norm(robot.fk(q).translation - far) - error) < 1e-9
    assert lost.history["position_error"].min() <= lost.position_error + 1e-9


@pytest.mark.parametrize("slowed", [False, True])
def test_the_picture_of_a_run_prints_nothing_over_anything_and_no_legend_beyond_its_edge(slowed):
    robot = ik.Robot.load("hydrolek_7w")
    run = ik.track(robot, ik.circle(robot.fk(robot.home), 0.02, duration=2.0), dt=0.04, q0=robot.home)
    if slowed:
        run.sigma = np.linspace(1.0, 0.3, 50)
        run.clock, run.pace = np.r_[0.0, np.cumsum(run.sigma) * run.dt], np.full(50, 2)
        run.limited[20:, 2] = 2
        run.joint_names = tuple(f"{name}_of_an_arm_with_long_names" for name in robot.joint_names)
    figure = ik.plot(run, robot)
    figure.canvas.draw()
    axes = [ax for ax in figure.axes if ax.name != "3d"]
    titles = [ax.get_title(loc="left") for ax in axes]
    assert len(axes) == 3 + slowed and any("clock rate" in title for title in titles) == slowed
    if slowed:
        assert "limited by elbow_pitch_of_an_arm_with_long_names" in titles[-1]
    boxes = [ax._left_title.get_window_extent() for ax in axes] + [ax.bbox for ax in axes]
    boxes += [ax.get_legend().get_window_extent() for ax in axes if ax.get_legend()]
    (joints,) = figure.legends
    boxes.append(joints.get_window_extent())
    assert (joints._ncols < 5) == slowed
    assert figure.bbox.x0 <= boxes[-1].x0 and boxes[-1].x1 <= figure.bbox.x1 and figure.bbox.y0 <= boxes[-1].y0
    for i, box in enumerate(boxes):  # one pixel is what rounding leaves
        assert not [other for other in boxes[:i] if box.padded(-1).overlaps(other)], titles


def test_joints_without_limits_are_drawn_within_a_half_turn_of_zero():
    robot = ik.Robot.load(CONTINUOUS)
    ends = (robot.fk(q).translation for q in (robot.home, robot.home + 0.1))
    run = ik.track(robot, ik.line(*ends, duration=0.5))
    positions = lines(ik.plot(run, robot).axes[2])
    for i, name in enumerate(robot.joint_names):
        shown = run.q[:, i] / (np.pi if np.isinf(robot.upper[i]) else 2.0)
        np.testing.assert_allclose(positions[name], shown, atol=1e-12)


def test_a_backend_loaded_by_a_chart_stays_interactive():
    import matplotlib

    assert not matplotlib.is_interactive()
    try:
        with plots.drawing():
            matplotlib.interactive(True)  # as the backend of notebooks does when the first figure loads it
        assert matplotlib.is_interactive()
    finally:
        matplotlib.interactive(False)


def test_plot_takes_what_the_calls_return(tmp_path):
    robot = ik.Robot.load("hydrolek_7w")
    target = robot.fk([0.4, 0.9, -0.4, 1.0, -1.0, 0.8])
    result = ik.solve(robot, target, history=True)
    run = ik.track(robot, ik.circle(robot.fk(robot.home), 0.02, duration=1.0), dt=0.05, q0=robot.home)
    path = ik.solve_path(robot, [robot.fk(q) for q in np.linspace(robot.home, result.q, 5)])
    titles = [
        [axis.get_title(loc="left") for axis in ik.plot(*what).axes]
        for what in (({"lm": result},), ({"cv": run},), (path,), (result.q, robot))
    ]
    assert titles[0] == [f"lm: {len(result.history['q']) - 1} iterations"]
    assert titles[1] == ["", ""] and len(titles[2]) == 2
    assert titles[3] == ["from the side", "from above"]
    figure = ik.plot({"home": robot.home, "found": result.q}, robot, target=target, file=tmp_path / "arm.svg")
    side, above = figure.axes
    assert np.allclose(side.lines[1].get_xydata()[-1], target.translation[[0, 2]], atol=1e-6)
    assert np.allclose(above.lines[2].get_xydata(), target.translation[:2])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["home", "found", "target"]
    assert ">found<" in (tmp_path / "arm.svg").read_text()
    for wrong in ((run,), (robot.home,)):
        with pytest.raises(InvalidOption, match="needs the robot"):
            ik.plot(*wrong)
    with pytest.raises(InvalidOption, match="a Robot or a Tree is needed"):
        ik.plot(robot.home, "hydrolek_7w")
    for what in (run, path, result):
        with pytest.raises(InvalidOption, match=r"as robot=, not 'p\.png'; to write the chart give file='p\.png'"):
            ik.plot(what, "p.png")
    with pytest.raises(ConfigurationNotFound):
        ik.plot("something", robot)


def test_stability_along_a_path_is_drawn():
    robot = ik.Robot.load("planar_2r")
    path = ik.circle(robot.fk(robot.home + 0.4).translation, 0.3, duration=2.0)
    found = ik.least_rate(robot, path, "cv", kappa=20.0, most=40.0)
    (axis,) = ik.plot(found).axes
    assert axis.get_title(loc="left") == f"stable from {found.rate:.4g} to 40 Hz"
    assert np.allclose(axis.lines[0].get_xdata(), found.rates) and repr(found) == f"LeastRate: {found.message}"
    with pytest.raises(InvalidOption, match="at least two values of gain"):
        ik.plot(chart := ik.stability_chart(robot, path, gain=[0.5], samples=[9]))
    assert "1 numbers of samples x 1 gains, 100 % stable" in repr(chart)
    with pytest.raises(InvalidOption, match="no chart of a GainCheck"):
        ik.plot(ik.check_gains("cv", 0.01, kappa=20.0))
