"""What a caller of the solvers can get wrong is refused in words that say what would be right."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.solvers.presets import from_preset, list_presets
from ik_toolkit.solvers.registry import find_row


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


@pytest.fixture(scope="module")
def tree():
    return robots.load("two_arms")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (dict(tolerance=-1.0), r"^tolerance must be finite and at least 1e-14, not -1\.0"),
        (dict(max_iterations=2**20), r"max_iterations is at most \d+, not 1048576; use restarts for longer searches"),
        (dict(mask=(1, 1, 1)), r"mask must have six weights \(x, y, z, rx, ry, rz\), not 3"),
        (dict(slack=(9.0,) * 5), "slack"),
        (dict(slack=(np.inf,) * 6), "leaves nothing that counts; leave the tip out instead"),
        (dict(follow=True), "follow bounds the move of each joint from q0, so q0 has to be given"),
        (dict(follow=True, restarts=3), "so it cannot be combined with restarts$"),
        (dict(follow=True, closest=True, objective="mid-range"), "cannot be combined with closest and objective"),
        (dict(timeout=1.0, max_evaluations=3), "give timeout or max_evaluations, not both"),
        (dict(seed=np.zeros(6)), "seed is the random seed of the restarts; the start is q0"),
        (dict(restarts=True), "restarts must be a whole number of at least 0, not True"),
        (dict(max_evaluations=0), "max_evaluations"),
        (dict(history="no"), "history must be True or False here, not 'no'"),
        (dict(frame="world"), "frame must be one of base, tip, target, not 'world'"),
        (dict(objective="middle"), r"objective must be one of .*, not 'middle'"),
        (dict(relative_to="tool"), "relative_to must be a dict from a tip to the tip its target is relative to"),
        (dict(tolerances=1e-3), r"there is no option 'tolerances'\. Did you mean 'tolerance'"),
    ],
)
def test_options(arm, options, said):
    with pytest.raises(InvalidOption, match=said):
        ik.solve(arm, arm.fk(arm.home), "lm", **options)


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
    with pytest.raises(
        InvalidOption, match=r"closest must be True or False here \(q0 is what the solution is nearest to\)"
    ):
        ik.Solver(arm, "lm", closest=q)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (dict(chain=True), r"chain= has been removed; ik.solve_path\(robot, poses\)"),
        (dict(history=True), "a batch keeps no history; solve the target in question with ik.solve"),
        (dict(timeout=1.0), "a batch is deterministic, so it takes no timeout; use max_evaluations"),
        (dict(check=2.0), "check must be the fraction of results to verify, 0 to 1, not 2.0"),
        (dict(check="all"), "check must be the fraction"),
        (dict(executor=3), "executor must be a pool with a submit method"),
    ],
)
def test_options_of_a_batch(arm, options, said):
    with pytest.raises(InvalidOption, match=said):
        ik.solve_batch(arm, np.zeros((2, 3)), "lm", **options)


def test_an_executor_has_its_own_workers(arm):
    from concurrent.futures import ThreadPoolExecutor

    with (
        ThreadPoolExecutor(1) as pool,
        pytest.raises(InvalidOption, match="an executor has its own workers; omit threads="),
    ):
        ik.solve_batch(arm, np.zeros((2, 3)), "lm", executor=pool, threads=2)


def test_targets_and_starts_of_a_batch(arm, tree):
    points = np.tile(arm.fk(arm.home).translation, (4, 1))
    with pytest.raises(InvalidConfiguration, match="q0 has 3 rows, fewer than there are targets"):
        ik.solve_batch(arm, iter([points]), "lm", q0=np.tile(arm.home, (3, 1)))
    first, second = tree.tips
    with pytest.raises(InvalidTarget, match=rf"targets of {first}, {second} must be numbers of shape \(N, 2, 4, 4\)"):
        ik.solve_batch(tree, np.zeros((2, 4, 4)), "lm")
    with pytest.raises(InvalidTarget, match=rf"every tip needs the same number of targets, not {first} 2, {second} 3"):
        ik.solve_batch(tree, {first: np.zeros((2, 3)), second: np.zeros((3, 3))}, "lm")
    with pytest.raises(InvalidTarget, match=rf"a dict of targets needs at least one of {first}, {second}"):
        ik.solve_batch(tree, {first: None}, "lm")
    with pytest.raises(InvalidTarget, match=rf"{second}: targets must be numbers of shape \(N, 4, 4\) or \(N, 3\)"):
        ik.solve_batch(tree, {second: np.zeros((2, 2))}, "lm")


def test_a_misspelled_field_of_a_pose_is_named(arm):
    with pytest.raises(FrameNotFound, match="Did you mean 'position'"):
        ik.solve(arm, {"positon": {"x": 1.0, "y": 0.0, "z": 0.0}})


def test_targets_of_several_tips(tree):
    first, second = tree.tips
    T = tree.fk(tree.home)[first]
    wanted = f"takes one target for each of {first}, {second}"
    for single in (T, T.homogeneous, T.translation):
        with pytest.raises(InvalidTarget, match=rf"{wanted} \(a dict, or a list in this order\), not a single one"):
            ik.solve(tree, single)
    with pytest.raises(InvalidTarget, match=rf"{wanted}; got 3 \(a dict may leave tips out: they are free\)"):
        ik.solve(tree, [T, T, T])
    with pytest.raises(InvalidTarget, match=f"give a target for at least one of {first}, {second}"):
        ik.solve(tree, {first: None})
    with pytest.raises(InvalidOption, match=r"mask: 'hand' is not one of the tips solved for"):
        ik.solve(tree, [T, T], mask={"hand": (1,) * 6})
    with pytest.raises(InvalidOption, match="joint_weights must have"):
        ik.solve(tree, [T, T], joint_weights=(1.0, 1.0))


def test_presets(arm, tmp_path):
    name = list_presets("pid")[0]
    with pytest.raises(
        InvalidOption, match=rf"solver 'pid' has no preset '{name}x'\. Did you mean '{name}'.*A file ends in .toml"
    ):
        from_preset(find_row("pid"), f"{name}x")
    with pytest.raises(
        InvalidOption, match=f"solver 'lm' has no preset '{name}'. These solvers have presets: pid, state-space"
    ):
        from_preset(find_row("lm"), name)
    file = tmp_path / "mine.toml"
    for text, said in (
        ('solver = "pid"\nparameters = 3\n', r"\[parameters\] and \[options\] must be tables"),
        ('solver = "pid"\noptions = 3\n', r"\[parameters\] and \[options\] must be tables"),
        ('solver = "pid"\n[parameters]\nkq = 1.0\n', r"solver 'pid' has no parameter 'kq'\. Did you mean 'k"),
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


def test_what_a_tip_is_relative_to_is_a_name(tree):
    first, second = tree.tips
    for wrong in ({first: 3}, {3: second}, {first: None}, [first, second]):
        with pytest.raises(
            InvalidOption, match="relative_to must be a dict from a tip to the tip its target is relative to"
        ):
            ik.solve(tree, tree.fk(tree.home), relative_to=wrong)


def test_a_tip_without_a_target_is_relative_to_nothing(tree):
    first, second = tree.tips
    only, poses = {first: tree.fk(tree.home)[first].homogeneous}, {first: tree.fk(tree.home)[first].homogeneous[None]}
    for call in (
        lambda: ik.solve(tree, only, relative_to={second: first}),
        lambda: ik.solve_batch(tree, poses, relative_to={second: first}),
        lambda: ik.solve_path(tree, poses, relative_to={second: first}),
        lambda: ik.Tracker(tree, relative_to={second: first}).update(only, 0.01),
    ):
        with pytest.raises(InvalidOption, match=f"'{second}' has no target; give it one in the frame of '{first}'"):
            call()
    with pytest.raises(InvalidOption, match="poses of every tip in the world; omit relative_to"):
        ik.place(tree, poses, relative_to={second: first})
    T = tree.fk(tree.home)
    free = ik.solve(tree, {first: T[second].actInv(T[first])}, q0=tree.home, relative_to={first: second})
    assert free.success  # the second tip may have no target
