"""What a caller of the solvers can get wrong is refused in words that say what would be right."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidConfiguration, InvalidOption, InvalidTarget, UnknownSolver
from ik_toolkit.solvers.presets import from_preset, list_presets
from ik_toolkit.solvers.registry import find_row


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (dict(TOLERANCE=1e-3), "Did you mean 'tolerance'"),
        (dict(tolerances=1e-3), r"there is no option 'tolerances'\. Did you mean 'tolerance'"),
        *[
            (dict(tolerance=no), "tolerance must be a number")
            for no in ("small", "1", True, 1j, np.timedelta64(1, "s"), np.timedelta64(1), np.ma.masked)
        ],
        (dict(tolerance=-1.0), r"^tolerance must be finite and at least 1e-14, not -1\.0"),
        (dict(tolerance=np.nan), "finite and at least 1e-14"),
        (dict(max_iterations=2.5), "whole number"),
        (dict(max_iterations=2**20), r"max_iterations is at most \d+, not 1048576; use restarts for longer searches"),
        (dict(restarts=-1), "restarts"),
        (dict(restarts=True), "restarts must be a whole number of at least 0, not True"),
        (dict(max_evaluations=0), "max_evaluations"),
        (dict(timeout=1.0, max_evaluations=3), "give timeout or max_evaluations, not both"),
        (dict(seed=np.zeros(6)), "seed is the random seed of the restarts; the start is q0"),
        (dict(seed=10**400), "seed"),
        (dict(history="no"), "history must be True or False here, not 'no'"),
        (dict(q0_outside="ignore"), "clamp"),
        (dict(limits="no"), "limits must be True, False, a dict from joint names"),
        (dict(follow=True), "follow bounds the move of each joint from q0, so q0 has to be given"),
        (dict(follow=-1.0), "follow"),
        (dict(follow=True, restarts=3), "so it cannot be combined with restarts$"),
        (dict(follow=True, closest=True, objective="mid-range"), "cannot be combined with closest and objective"),
        (dict(objective="middle"), r"objective must be one of .*mid-range.*, not 'middle'"),
        (dict(objective=["mid-range"]), "objective must be one of"),
        (dict(joint_weights=(1, 1)), "6 values"),
        (dict(joint_weights="ab"), "joint_weights must be numbers"),
        (dict(mask=(1, 1, 1)), r"mask must have six weights \(x, y, z, rx, ry, rz\), not 3"),
        (dict(mask=("x",) * 6), "mask must be numbers"),
        (dict(mask={"hand": [1] * 6}), "not one of the tips"),
        (dict(slack=(0.1,) * 3), "six half widths"),
        (dict(slack=[0.1] * 5 + [-1e-3]), "at least 0"),
        (dict(slack=[np.nan] * 6), "at least 0"),
        (dict(slack=(np.inf,) * 6), "leaves nothing that counts; leave the tip out instead"),
        (dict(slack=[np.inf] * 3 + [4.0] * 3), "nothing that counts"),
        (dict(mask=[1, 0, 0, 0, 0, 0], slack=[np.inf, 0, 0, 0, 0, 0]), "nothing that counts"),
        (dict(free_turn=[0, 0, 0]), "axis of the tip"),
        (dict(free_turn=[0, 0]), "axis of the tip"),
        (dict(free_turn="w"), "free_turn must be x, y, z"),
        (dict(frame="world"), "frame must be one of base, tip, target, not 'world'"),
        (dict(frame=np.array(["base", "tip"])), "base, tip, target"),
        (dict(relative_to="tool"), "relative_to must be a dict from a tip to the tip its target is relative to"),
        (dict(relative_to={"a": "b"}), "several tips"),
        (dict(avoid_collisions=np.zeros(3)), "avoid_collisions must be"),
        (dict(from_q=np.zeros(6)), r"robot\.fk\(q\)"),
        (dict(solver="dls", dampin=1), r"no option 'dampin'\. Did you mean 'damping'"),
        (dict(solver="dls", damping=np.nan), "NaN"),
        (dict(damping=[1, 2]), r"finite numbers, not damping=\[1, 2\]"),
        (dict(solver=ik.LM(damping=None)), "parameters of solver 'lm'"),
        (dict(solver=ik.PID(kp="fast")), "kp='fast'"),
        (dict(solver=ik.PID(starts="home")), "starts must be numbers"),
        (dict(solver="newton", target=(0.5, 0, 0)), "as many task rows"),
    ],
)
def test_options(arm, arguments, said):
    with pytest.raises(InvalidOption, match=said):
        ik.solve(arm, **{"target": arm.fk(arm.home), "solver": "lm", **arguments})


@pytest.mark.parametrize(
    ("arguments", "error", "said"),
    [
        (dict(target="nonsense"), InvalidTarget, "nonsense"),
        (dict(target={"positon": {"x": 1.0, "y": 0.0, "z": 0.0}}), FrameNotFound, "Did you mean 'position'"),
        (dict(solver="lmm"), UnknownSolver, "Did you mean 'lm'"),
        (dict(solver="LM"), UnknownSolver, "Did you mean 'lm'"),
        (dict(solver="State-Space"), UnknownSolver, "Did you mean 'state-space'"),
        (dict(solver=int), UnknownSolver, "not the class int"),
        (dict(solver=1), UnknownSolver, "a name, a rule class or an instance of one, not 1. Available: lm,"),
        (dict(q0=[0, 0]), InvalidConfiguration, "6 values"),
        (dict(q0=[9] * 6, q0_outside="refuse"), InvalidConfiguration, "azimuth_yaw"),
    ],
)
def test_targets_solvers_and_starts(arm, arguments, error, said):
    with pytest.raises(error, match=said):
        ik.solve(arm, **{"target": arm.fk(arm.home), **arguments})


@pytest.mark.filterwarnings("error")
def test_infinity_is_no_whole_number(arm):
    with pytest.raises(InvalidOption, match="starts must be a whole number of at least 1, not inf"):
        ik.solve_all(arm, arm.fk(arm.home), "lm", starts=np.inf)


def test_what_chooses_among_solutions_is_no_option_of_all_of_them(arm):
    for options in (dict(closest=arm.home), dict(closest=True), dict(objective="mid-range"), dict(follow=0.1)):
        (name,) = options
        with pytest.raises(InvalidOption, match=f"so it takes no '{name}'"):
            ik.solve_all(arm, arm.fk(arm.home), **options)
    unset = dict(closest=False, objective=None, follow=0, timeout=None, history=np.False_)
    assert len(ik.solve_all(arm, arm.fk(arm.home), **unset)) == len(ik.solve_all(arm, arm.fk(arm.home)))


def test_closest_and_a_start(arm):
    q = arm.home
    with pytest.raises(InvalidOption, match="give closest=q_ref or q0, not both: the search starts at q_ref"):
        ik.solve(arm, arm.fk(q), closest=q, q0=q)
    with pytest.raises(InvalidConfiguration, match=f"^closest must have {arm.n} values"):
        ik.solve(arm, arm.fk(q), closest=q[:-1])
    said = r"closest must be True or False here \(q0 is what the solution is nearest to\)"
    with pytest.raises(InvalidOption, match=said):
        ik.Solver(arm, "lm", closest=q)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (dict(chain=True), r"chain= has been removed; ik.solve_path\(robot, poses\)"),
        (dict(threads=0), "threads"),
        (dict(threads=1.5), "threads"),
        (dict(tolerence=1), "tolerance"),
        (dict(history=True), "a batch keeps no history; solve the target in question with ik.solve"),
        (dict(timeout=1.0), "a batch is deterministic, so it takes no timeout; use max_evaluations"),
        (dict(check=2.0), "check must be the fraction of results to verify, 0 to 1, not 2.0"),
        (dict(check="all"), "check must be the fraction"),
        (dict(executor=ThreadPoolExecutor(1), threads=2), "an executor has its own workers; omit threads="),
        (dict(executor=3), "executor must be a pool with a submit method"),
        (dict(executor=ThreadPoolExecutor), "executor must be a pool with a submit method"),
    ],
)
def test_options_of_a_batch(arm, options, said):
    with pytest.raises(InvalidOption, match=said):
        ik.solve_batch(arm, np.zeros((2, 3)), "lm", **options)


def test_options_of_several_tips(brokk):
    T = brokk.fk(brokk.home)
    with pytest.raises(InvalidOption, match=r"mask: 'hand' is not one of the tips solved for"):
        ik.solve(brokk, T, mask={"hand": (1,) * 6})
    with pytest.raises(InvalidOption, match="joint_weights must have"):
        ik.solve(brokk, T, joint_weights=(1.0, 1.0))


def test_presets(arm, tmp_path):
    name = list_presets("pid")[0]
    for solver, preset, said in (
        ("pid", f"{name}x", rf"solver 'pid' has no preset '{name}x'\. Did you mean '{name}'.*A file ends in .toml"),
        ("pid", "missing.toml", "missing"),
        ("lm", name, f"solver 'lm' has no preset '{name}'. These solvers have presets: pid, state-space"),
    ):
        with pytest.raises(InvalidOption, match=said):
            from_preset(find_row(solver), preset)
    file = tmp_path / "mine.toml"
    for text, said in (
        ('solver = "pid"\nparameters = 3\n', r"\[parameters\] and \[options\] must be tables"),
        ('solver = "pid"\noptions = 3\n', r"\[parameters\] and \[options\] must be tables"),
        ('solver = "pid"\n[parameters]\nkq = 1.0\n', r"solver 'pid' has no parameter 'kq'\. Did you mean 'k"),
        ('solver = "pid"\n[options]\ntolerence = 1\n', r"mine\.toml: .*tolerence"),
        ('solver = "pid"\n[option]\ntolerance = 1\n', r"unknown table \[option\]\. Did you mean 'options'"),
        ("solver = " + 5000 * "[", r"mine\.toml cannot be read"),
        ("solver = " + 5000 * "9", r"mine\.toml cannot be read"),
        ('solver = "state-space"\n', "is for solver 'state-space', not 'pid'"),
        ("solver = ", "cannot be read"),
    ):
        file.write_text(text)
        with pytest.raises(InvalidOption, match=said):
            from_preset(find_row("pid"), file)
    with pytest.raises(InvalidOption, match=r"pid: starts hold 6 finite values each \(azimuth_yaw, .*\), not \(1, 2\)"):
        ik.solve(arm, arm.fk(arm.home), "pid", starts=[[0.0, 0.0]])


def test_positions_have_no_orientation_that_could_count(arm):
    point = arm.fk(arm.home).translation
    for counts in (dict(mask=(1, 1, 0, 0, 0, 0)), dict(slack=(0.01, 0.01, 0.01, 9.0, 9.0, 9.0))):
        with pytest.raises(InvalidOption, match="a position has no axes of its own, so frame='target' needs a pose"):
            ik.solve(arm, point, "lm", frame="target", **counts)
        assert ik.solve(arm, point, "lm", q0=arm.home, **counts).success


def test_what_a_tip_is_relative_to_is_a_name(brokk):
    first, second = brokk.tips
    said = "relative_to must be a dict from a tip to the tip its target is relative to"
    for wrong in ({first: 3}, {3: second}, {first: None}, [first, second]):
        with pytest.raises(InvalidOption, match=said):
            ik.solve(brokk, brokk.fk(brokk.home), relative_to=wrong)


def test_a_tip_without_a_target_is_relative_to_nothing(brokk):
    first, second = brokk.tips
    pose = brokk.fk(brokk.home)[first].homogeneous
    only, poses = {first: pose}, {first: pose[None]}
    for call in (
        lambda: ik.solve(brokk, only, relative_to={second: first}),
        lambda: ik.solve_batch(brokk, poses, relative_to={second: first}),
        lambda: ik.solve_path(brokk, poses, relative_to={second: first}),
        lambda: ik.Tracker(brokk, relative_to={second: first}).update(only, 0.01),
    ):
        with pytest.raises(InvalidOption, match=f"'{second}' has no target; give it one in the frame of '{first}'"):
            call()
    with pytest.raises(InvalidOption, match="poses of every tip in the world; omit relative_to"):
        ik.place(brokk, poses, relative_to={second: first})
    T = brokk.fk(brokk.home)
    free = ik.solve(brokk, {first: T[second].actInv(T[first])}, q0=brokk.home, relative_to={first: second})
    assert free.success  # the second tip may have no target
