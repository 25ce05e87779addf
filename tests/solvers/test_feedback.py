"""Feedback solvers: presets, designed gains, several maps chosen by start, stability bounds of the docstring."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidOption
from ik_toolkit.solvers.presets import list_presets, write_preset
from ik_toolkit.solvers.rules.state_space import inverse_maps, spread_starts
from ik_toolkit.study.targets import sample_targets
from ik_toolkit.study.tune import score

ONE = dict(tolerance=1e-3, max_iterations=1000)


def tips(robot, count, seed, position_only=True):
    return sample_targets(robot, count, seed, position_only=position_only)


# ------------------------------------------------------------------------------------------------------------ presets
def test_presets_bring_tolerance_and_iterations():
    robot = robots.load("hydrolek_7w")
    for cls in (ik.PID, ik.StateSpace):
        solver = ik.Solver(robot, cls.preset("burrell-2016"))
        assert solver.options.position_tolerance == 1e-3
        assert solver.options.max_iterations == 1000
        assert ik.Solver(robot, cls.preset("burrell-2016"), tolerance=1e-4).options.position_tolerance == 1e-4


def test_published_gains():
    pid = ik.PID.preset("burrell-2016")
    assert (pid.kp, pid.ki, pid.kd, pid.units) == (0.012, 1e-7, 0.08, "mm-deg")
    rule = ik.StateSpace.preset("burrell-2016")
    assert (np.asarray(rule.A) == -0.5 * np.eye(6)).all() and (np.asarray(rule.C) == -0.05 * np.eye(6)).all()
    assert np.asarray(rule.B).T.tolist() == [[0, 0, -1, 0, 0, 0], [0, -1, -1, 0, 1, 0], [1, 0, 0, 1, 0, 0]]
    assert rule.units == "mm-deg"


def test_every_shipped_preset_runs():
    for solver, cls in (("pid", ik.PID), ("state-space", ik.StateSpace)):
        assert "burrell-2016" in list_presets(solver)
        for name in list_presets(solver):
            rule = cls.preset(name)
            if name.startswith(("ur5", "panda")):
                if not robots.have_data():
                    continue
                robot = robots.load(name.split("-")[0])
            else:
                robot = robots.load("hydrolek_7w")
            position = not name.endswith("pose")
            found = score(robot, rule, [tips(robot, 100, 5, position)], **rule.options())
            assert found.share > 0.4, f"{solver} {name}: {found}"


def test_preset_files_keep_every_bit(tmp_path):
    rng = np.random.default_rng(0)
    B, starts = rng.normal(size=(4, 6, 3)), rng.uniform(-0.1, 0.1, (4, 6))
    values = {"A": 1e-9 * np.eye(6), "B": B, "C": np.eye(6) / 3, "starts": starts}
    options = {"tolerance": 1e-4, "slack": (0.1, 0.0, 0.0, np.inf, 0.0, 0.0), "limits": False}
    write_preset(tmp_path / "x.toml", "state-space", values, options, {"source": 'a "b" \\ c'})
    rule = ik.StateSpace.preset(tmp_path / "x.toml")
    for key, value in values.items():
        assert (np.asarray(getattr(rule, key)) == value).all()
    assert rule.options() == options | {"slack": [*options["slack"]]}


# ---------------------------------------------------------------------------------------------------------- stability
def final_error(rule, kappa):
    """Error left of 1 on a sliding robot, where J is the identity and the loop gain is exactly what the gains say."""
    robot = robots.load("cartesian_pp")
    J = robot.jacobian(robot.home)[:3]
    rule = rule(kappa, np.linalg.pinv(J))
    target = robot.fk(robot.home).translation + J @ np.full(2, 1e-3)
    solver = ik.Solver(robot, rule, tolerance=1e-12, max_iterations=400, limits=False, history=True)
    return solver(target, q0=robot.home).history["position_error"][-1] / np.linalg.norm(J @ np.full(2, 1e-3))


def literal(a):
    return lambda kappa, G: ik.StateSpace(A=a * np.eye(2), B=G, C=kappa * np.eye(2))


def feedthrough(kappa, G):
    return ik.StateSpace(D=kappa * G)


@pytest.mark.parametrize(
    ("rule", "bound"), [(literal(-0.5), 1.5), (literal(0.0), 1.0), (literal(-0.9), 1.9), (feedthrough, 2.0)]
)
def test_loop_is_stable_exactly_below_the_bound(rule, bound):
    assert final_error(rule, bound - 0.03) < 1e-1
    assert final_error(rule, 0.5 * bound) < 1e-6
    assert final_error(rule, bound + 0.03) > 10.0
    assert final_error(rule, -0.02) > 10.0


def test_undelayed_form_of_the_published_a_is_stable_only_below_one():
    def undelayed(kappa, G):
        return ik.StateSpace(A=-0.5 * np.eye(2), B=G, C=-0.5 * kappa * np.eye(2), D=kappa * G)

    assert final_error(undelayed, 0.97) < 1e-1
    assert final_error(undelayed, 1.03) > 10.0


# ------------------------------------------------------------------------------------------------------------- design
@pytest.mark.parametrize(
    "name", ["hydrolek_7w", "planar_3r", "slides_mix", "mimic_mix", "continuous_mix", "inspection_7dof"]
)
def test_designed_maps_are_inverses_where_they_are_meant(name):
    robot = robots.load(name)
    position = name == "planar_3r"
    assert (spread_starts(robot, position, 1) == robot.home).all()
    starts = spread_starts(robot, position, 16)
    maps = inverse_maps(robot, starts, position)
    assert starts.shape[1] == robot.n and maps.shape == (len(starts), robot.n, 3 if position else 6)
    assert (starts >= robot.lower).all() and (starts <= robot.upper).all()
    largest = []
    for q, G in zip(starts, maps, strict=True):
        J = robot.jacobian(q)[: G.shape[1]]
        largest.append(np.abs(np.linalg.eigvals(J @ G)).max())
    assert max(largest) < 2.0  # a feedthrough of gain 1 is stable at every start
    assert np.median(largest) > 0.6
    assert (spread_starts(robot, position, 16) == starts).all()


def test_starts_keep_a_joint_of_one_value_there():
    robot = robots.load("hydrolek_7w")
    starts = spread_starts(robot.narrowed({robot.joint_names[2]: (0.3, 0.3)}), True, 8)
    assert (starts[:, 2] == 0.3).all() and len(np.unique(starts, axis=0)) == 8


@pytest.mark.parametrize(("name", "pid"), [("hydrolek_7w", 0.98), ("inspection_7dof", 0.9), ("mimic_mix", 0.75)])
def test_without_gains_most_positions_are_reached(name, pid):
    robot = robots.load(name)
    for solver, least in (("state-space", 0.9), ("pid", pid)):
        assert score(robot, solver, [tips(robot, 300, 3)], **ONE).share > least, solver


def test_design_is_kept_with_the_robot_and_not_shared_with_its_variants():
    robot = ik.Robot.load("hydrolek_7w")
    first = ik.StateSpace().resolve(robot, True)
    assert ik.StateSpace().resolve(robot, True) is first
    assert ik.StateSpace().resolve(robot.locked({"wrist_roll": 0.1}), True) is not first


# ------------------------------------------------------------------------------------------------------- starts, maps
def test_the_start_nearest_the_target_is_taken():
    robot = robots.load("hydrolek_7w")
    starts = spread_starts(robot, True, 11)  # not a multiple of the table's width
    rule = ik.StateSpace(D=inverse_maps(robot, starts, True), starts=starts)
    solver = ik.Solver(robot, rule, history=True, **ONE)
    where = robot.chain.forward(starts)[0][:, :3, 3]
    for target in tips(robot, 40, 1):
        first = solver(target).history["q"][0]
        k = int(((where - target) ** 2).sum(1).argmin())
        assert np.abs(first - starts[k]).max() < 1e-12


def test_each_start_selects_its_map_and_q0_selects_the_nearest():
    robot = robots.load("hydrolek_7w")
    starts = spread_starts(robot, True, 8)
    maps = inverse_maps(robot, starts, True) * np.arange(1, 9)[:, None, None] / 40
    solver = ik.Solver(robot, ik.StateSpace(D=maps, starts=starts), history=True, tolerance=1e-9, max_iterations=1)
    for k, q in enumerate(starts):
        target = robot.fk(q).translation + np.array([0.01, -0.02, 0.005])
        expected = np.clip(q + maps[k] @ (target - robot.fk(q).translation), robot.lower, robot.upper)
        assert np.abs(solver(target, q0=q).history["q"][1] - expected).max() < 1e-12
        free = solver(target).history["q"]
        if np.abs(free[0] - q).max() < 1e-12:
            assert np.abs(free[1] - expected).max() < 1e-12


def test_restarts_take_the_next_starts():
    robot = robots.load("hydrolek_7w")
    targets = [tips(robot, 500, 9)]
    starts = spread_starts(robot, True, 16)
    rule = ik.StateSpace(D=0.9 * inverse_maps(robot, starts, True), starts=starts)
    one, many = (score(robot, rule, targets, restarts=k, **ONE) for k in (0, 7))
    assert many.share > one.share


@pytest.mark.parametrize(
    "wrong",
    [
        dict(A=np.eye(6), B=np.zeros((6, 3))),
        dict(A=np.eye(6), B=np.zeros((5, 3)), C=np.eye(6)),
        dict(A=np.eye(6), B=np.zeros((6, 3)), C=np.eye(5)),
        dict(D=np.zeros((6, 2))),
        dict(D=np.zeros((2, 6, 3)), starts=np.zeros((3, 6))),
        dict(D=np.zeros((6, 3)), starts=np.zeros((3, 5))),
        dict(D=np.full((6, 3), np.nan)),
        dict(D=np.zeros((6, 3)), units="inch"),
    ],
)
def test_wrong_shapes_are_refused(wrong):
    robot = robots.load("hydrolek_7w")
    with pytest.raises(IKError, match="state-space"):
        ik.Solver(robot, ik.StateSpace(**wrong))(robot.fk(robot.home).translation)


def test_three_columns_do_not_solve_poses():
    robot = robots.load("hydrolek_7w")
    with pytest.raises(InvalidOption, match="pose"):
        ik.Solver(robot, ik.StateSpace(D=np.zeros((6, 3))))(robot.fk(robot.home))


def test_pid_starts():
    robot = robots.load("hydrolek_7w")
    q = robot.home + 0.05
    solver = ik.Solver(robot, ik.PID(starts=[q]), history=True)
    assert np.abs(solver(tips(robot, 1, 1)[0]).history["q"][0] - q).max() < 1e-12
    with pytest.raises(InvalidOption, match="starts"):
        ik.Solver(robot, ik.PID(starts=[[1.0]]))(tips(robot, 1, 1)[0])


# ------------------------------------------------------------------------------------------- the tuned presets' gates
def test_tuned_presets_reach_their_gates_on_fresh_goals():
    robot = robots.load("hydrolek_7w")
    sets = [tips(robot, 1000, [2016, k]) for k in range(4)]
    for rule, gate in (
        (ik.StateSpace.preset("hydrolek-7w"), 0.997),
        (ik.StateSpace.preset("hydrolek-7w-delayed"), 0.997),
        (ik.StateSpace.preset("hydrolek-7w-one-map"), 0.988),
        (ik.PID.preset("hydrolek-7w"), 0.994),
    ):
        found = score(robot, rule, sets, **rule.options())
        assert found.share >= gate, found
        assert found.iterations < 100
