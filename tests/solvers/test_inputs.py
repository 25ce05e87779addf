"""Input validation on every path: last rows, number types, layouts, masks, buffers that change."""

import datetime
import math

import numpy as np
import pytest
from robots import load, sample
from second_fk import SecondFK

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.robot.pose import AxisTarget, check_target
from ik_toolkit.solvers.batch.parts import AHEAD
from ik_toolkit.solvers.batch.solve_batch import solve_parts

ARM = "hydrolek_7w"


def good():
    """A robot and the pose of its tip at home (4, 4)."""
    robot = load(ARM)
    return robot, robot.fk(robot.home).homogeneous


def every_way(robot, T):
    """Calls that take a pose, by name."""
    start = good()[1]
    tree = load("two_arms")
    return {
        "solve": lambda: ik.solve(robot, T, "lm"),
        "Solver": lambda: ik.Solver(robot, "lm")(T),
        "Solver with q0": lambda: ik.Solver(robot, "lm")(T, robot.home),
        "solve_all": lambda: ik.solve_all(robot, T, starts=2),
        "batch of one": lambda: ik.solve_batch(robot, np.asanyarray(T)[None], "lm"),
        "list": lambda: ik.solve_batch(robot, [start, T], "lm"),
        "iterator": lambda: ik.solve_batch(robot, iter([start[None], np.asanyarray(T)[None]]), "lm"),
        "path": lambda: ik.solve_path(robot, np.asanyarray(T)[None]),
        "tree": lambda: ik.Solver(tree)([T, T]),
        "with_tool": lambda: robot.with_tool(T),
        "AxisTarget": lambda: AxisTarget(T, (0.0, 0.0, 1.0)),
    }


def with_last_row(row):
    T = good()[1].copy()
    T[3] = row
    return T


def no_poses():
    """What is no pose, by name: with a wrong last row, or what numpy would turn into numbers; and a word of what is said."""
    T = good()[1]
    hidden = np.ma.array(T, mask=np.zeros((4, 4), dtype=bool))
    hidden[0, 3] = np.ma.masked
    return {
        "transposed": (T.T.copy(), "transposed"),
        "a transposed view": (T.T, "transposed"),
        "another last row": (with_last_row([1.0, 2.0, 3.0, 4.0]), "last row"),
        "a last row that is a little off": (with_last_row([0.0, 0.0, 0.0, 1.0 + 1e-6]), "last row"),
        "a last row of zeros": (with_last_row([0.0, 0.0, 0.0, 0.0]), "last row"),
        "a last row of NaN": (with_last_row([math.nan] * 4), "finite"),
        "a last row with infinity": (with_last_row([0.0, 0.0, math.inf, 1.0]), "finite"),
        "dates": (np.array([["2026-01-01"] * 4] * 4, dtype="M8[D]"), None),
        "lengths of time": (np.ones((4, 4), dtype="m8[s]"), None),
        "complex": (T + 0.5j, None),
        "masked": (hidden, None),
        "objects": (T.astype(object), None),
        "nothing": (np.full((4, 4), None), None),
        "truth values": (np.eye(4, dtype=bool), None),
        "texts": (T.astype(str), None),
        "bytes": (T.astype("S20"), None),
        "records": (np.zeros((4, 4), dtype=[("x", float)]), None),
    }


@pytest.mark.parametrize("name", list(no_poses()))
def test_what_is_no_pose_is_refused_everywhere(name):
    T, words = no_poses()[name]
    for way, call in every_way(load(ARM), T).items():
        with pytest.raises(InvalidTarget, match=words):
            call()
            pytest.fail(way)


def test_the_row_of_a_batch_that_looks_transposed_is_named():
    robot = load(ARM)
    T = sample(robot, 3000, seed=2)[1]
    T[2222] = T[2222].T.copy()
    with pytest.raises(InvalidTarget, match=r"target 2222: .*transposed"):
        ik.solve_batch(robot, T, "lm")


@pytest.mark.parametrize(
    "three",
    [
        ["1", "2", "3"],
        [1.0, 2.0, 3.0 + 1j],
        np.array([1, 2, 3], dtype="m8[s]"),
        np.array([1.0, 2.0, None]),
        [True, False, True],
        [datetime.date(2026, 1, 1)] * 3,
        np.ma.array([1.0, 2.0, 3.0], mask=[0, 1, 0]),
        [np.ma.masked, 1.0, 2.0],
    ],
    ids=repr,
)
def test_what_is_not_a_number_is_refused_wherever_numbers_go_in(three):
    robot = load(ARM)
    six = [*three, *three] if isinstance(three, list) else np.ma.concatenate([three, three])
    T = robot.fk(robot.home).homogeneous
    for call, error in (
        (lambda: ik.solve(robot, three), InvalidTarget),
        (lambda: ik.pose(three), InvalidTarget),
        (lambda: ik.pose((1, 0, 0), rpy=three), InvalidTarget),
        (lambda: ik.pose((1, 0, 0), rotation=[three, three, three]), InvalidTarget),
        (lambda: ik.pose((1, 0, 0), direction=three), InvalidTarget),
        (lambda: ik.solve_batch(robot, [three, three]), InvalidTarget),
        (lambda: robot.fk(six), InvalidConfiguration),
        (lambda: ik.solve(robot, T, q0=six), InvalidConfiguration),
        (lambda: ik.solve_batch(robot, T[None], q0=six), InvalidConfiguration),
        (lambda: ik.solve_batch(robot, T[None], q0=[six]), InvalidConfiguration),
    ):
        with pytest.raises(error):
            call()


@pytest.mark.parametrize("value", [True, "1e-3", 1e-3 + 0j, np.array([1e-3, 1e-3]), None])
def test_a_tolerance_is_one_real_number(value):
    with pytest.raises(InvalidOption, match="position_tolerance"):
        ik.solve(*good(), position_tolerance=value)


def test_a_mask_may_be_of_truth_values():
    robot, T = good()
    for mask in ([True] * 3 + [False] * 3, np.array([1, 1, 1, 0, 0, 0], dtype=bool)):
        assert ik.solve(robot, T, mask=mask).success
    with pytest.raises(InvalidOption, match="mask"):
        ik.solve(robot, T, mask=["1"] * 6)


def layouts(T):
    """The same poses (N, 4, 4), and those of fewer digits, in arrays of many kinds."""
    wide = np.zeros((len(T), 4, 8))
    wide[:, :, ::2] = T
    frozen = T.copy()
    frozen.setflags(write=False)
    whole = np.round(T)
    return {
        "strided": (wide[:, :, ::2], T),
        "backwards": (T[::-1], T[::-1]),
        "fortran": (np.asfortranarray(T), T),
        "read-only": (frozen, T),
        "other byte order": (T.astype(">f8"), T),
        "float32": (T.astype(np.float32), T.astype(np.float32).astype(float)),
        "long double": (T.astype(np.longdouble), T),
        "matrix subclass": (np.ma.array(T), T),
        "list": (list(T), T),
        "nested lists": (T.tolist(), T),
        "whole numbers": (whole.astype(np.int32), whole),
    }


@pytest.mark.parametrize("name", list(layouts(np.zeros((1, 4, 4)))))
def test_the_layout_of_an_array_changes_nothing(name):
    robot = load(ARM)
    T = sample(robot, 12, seed=9)[1]
    if name == "whole numbers":  # positions only: few whole rotations are rigid
        T[:, :3, :3] = np.eye(3)
    given, meant = layouts(T)[name]
    solver = ik.Solver(robot, "lm")
    many = ik.solve_batch(robot, given, "lm")
    wanted = ik.solve_batch(robot, np.ascontiguousarray(meant), "lm")
    assert many.table.tobytes() == wanted.table.tobytes()
    positions = given[:, :3, 3] if isinstance(given, np.ndarray) else [x[:3, 3] for x in meant]
    only = ik.solve_batch(robot, positions, "lm")
    assert only.table.tobytes() == ik.solve_batch(robot, meant[:, :3, 3].copy(), "lm").table.tobytes()
    for one, other in zip(given, meant, strict=True):
        assert solver(one).q.tobytes() == solver(check_target(other)[0]).q.tobytes()


def test_an_axis_target_is_looked_at_when_it_is_made():
    robot, T = good()
    kept = AxisTarget(T.tolist(), [0, 0, 2])
    assert kept.axis == (0.0, 0.0, 1.0) and ik.solve(robot, kept, "lm").success
    for T_base_tip, axis in ((np.zeros((4, 4)), (0, 0, 1)), (T, (0, 0, 0)), (T, "w"), (T[:3, 3], (0, 0, 1))):
        with pytest.raises(InvalidTarget):
            AxisTarget(T_base_tip, axis)


# ---------------------------------------------------------------------------------------------------------- reused buffers
@pytest.mark.parametrize("share", [0.01, 1.0])
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_buffer_that_an_iterator_refills_gives_each_row_its_own_answer(share, kind):
    robot = load(ARM)
    judge = SecondFK(robot.urdf, base=robot.base, tip=robot.tip)
    T = sample(robot, 1500, seed=5)[1].astype(kind)
    buffer = np.empty((100, 4, 4), dtype=kind)

    def chunks():
        for a in range(0, len(T), len(buffer)):
            buffer[:] = T[a : a + len(buffer)]
            yield buffer

    many = ik.solve_batch(robot, chunks(), "lm", check=share)
    assert many.table.tobytes() == ik.solve_batch(robot, T, "lm").table.tobytes()
    off = np.linalg.norm(judge.fk(many.q, robot.joint_names)[:, :3, 3] - T[:, :3, 3], axis=1)
    assert many.success.all() and off.max() <= 1e-6 + 1e-12


def test_an_array_that_changes_between_the_parts_changes_no_part_already_read():
    """Of five parts four are read when the first is handed out; once those waiting were views of the array."""
    robot = load(ARM)
    first, later = sample(robot, 9000, seed=6)[1], sample(robot, 9000, seed=7)[1]
    buffer, seen = first.copy(), []
    for part in solve_parts(robot, buffer, "lm", threads=1, check=0.0):
        buffer[:] = later
        rows = slice(sum(map(len, seen)), sum(map(len, seen)) + len(part))
        seen.append(part)
        meant = (first if len(seen) <= AHEAD else later)[rows, :3, 3]
        assert np.linalg.norm(robot.chain.forward(part.q)[0][:, :3, 3] - meant, axis=1).max() <= 1e-6 + 1e-12
    assert len(seen) == AHEAD + 1


# ---------------------------------------------------------------------------------------------------------------- options
@pytest.mark.parametrize("weights", [(1, 1, 1, 0, 0, 1), (0, 0, 0, 1, 1, 1), (1, 1, 0, 0, 1e-3, 0)])
def test_a_position_has_no_rotation_to_weigh(weights):
    robot = load(ARM)
    xyz = robot.fk(robot.home).translation
    said = "a position leaves orientation free, so the last three weights of its mask must be 0, not "
    for call in (
        lambda: ik.solve(robot, xyz, mask=weights),
        lambda: ik.Solver(robot, "lm", mask=weights)(xyz),
        lambda: ik.solve_batch(robot, xyz[None], mask=weights),
        lambda: ik.solve_path(robot, xyz[None], mask=weights),
        lambda: ik.solve_all(robot, xyz, mask=weights),
    ):
        with pytest.raises(InvalidOption, match=said):
            call()
    assert ik.solve(robot, xyz, mask=(1, 1, 0, 0, 0, 0)).success


@pytest.mark.parametrize("options", [{"free_turn": "z"}, {"priority": "orientation"}, {"slack": (0, 0, 0, 0.1, 0, 0)}])
def test_what_is_about_orientation_alone_is_refused_for_positions(options):
    tree = load("two_arms")
    (left, right), at = tree.tips, tree.fk(tree.home)
    places = {left: at[left].translation, right: at[right].translation}
    (name,) = options
    for call in (
        lambda: ik.solve(tree, places, **options),
        lambda: ik.solve_batch(tree, {tip: [place] for tip, place in places.items()}, **options),
        lambda: ik.solve_path(tree, {tip: [place, place + 0.01] for tip, place in places.items()}, **options),
    ):
        with pytest.raises(InvalidOption, match=f"{name} has no effect on a position"):
            call()
    assert ik.solve(tree, {**places, left: at[left]}, q0=tree.home, **options).success  # One tip has an orientation.


@pytest.mark.parametrize("name", ["limits", "closest", "history", "check"])
def test_one_is_not_true_whatever_was_asked_before(name):
    robot, T = good()
    for value in (True, False):
        ik.solve(robot, T, **{name: value})
    for value in (1, 0, 1.0):
        if name != "closest":
            with pytest.raises(InvalidOption, match=name):
                ik.solve(robot, T, **{name: value})
    with pytest.raises(InvalidOption, match="seed"):
        ik.solve(robot, T, seed=0)
        ik.solve(robot, T, seed=False)


def test_a_home_outside_the_limits_is_refused():
    """A search without q0 may start there; that no limit was kept showed as a status that does not exist."""
    robot = load(ARM)
    for home in (robot.upper + 0.1, np.where(np.arange(robot.n) == 2, robot.lower - 1e-9, robot.home)):
        with pytest.raises(InvalidConfiguration, match=f"home is outside the limits at joint .*{robot.joint_names[2]}"):
            ik.Robot(robot.model, tip=robot.tip, home=home)
    assert ik.Solver(ik.Robot(robot.model, tip=robot.tip, home=robot.upper), "lm", restarts=0)((1.0, 0.0, 0.5)).q.size


@pytest.mark.parametrize(
    "call",
    [ik.solve, ik.solve_all, lambda robot, T, seed: ik.solve_batch(robot, [T], seed=seed)],
    ids=["solve", "solve_all", "solve_batch"],
)
def test_no_seed_is_not_a_seed(call):
    """None came through to the compiler, whose own error showed."""
    with pytest.raises(InvalidOption, match="seed must be a number, not None"):
        call(*good(), seed=None)
    with pytest.raises(InvalidOption, match="between 0 and 2147483648"):
        call(*good(), seed=2**31 + 1)


HUGE = 10**400  # no float is as large: numpy and float() raise OverflowError


@pytest.mark.parametrize(
    "call",
    [
        lambda robot, T: ik.solve_all(robot, T, count=HUGE),
        lambda robot, T: ik.solve_all(robot, T, starts=HUGE),
        lambda robot, T: ik.solve_batch(robot, [T], threads=HUGE),
        lambda robot, T: ik.solve_path(robot, [T, T], threads=HUGE),
        lambda robot, T: ik.solve_path(robot, [T, T], reconfigurations=HUGE),
        lambda robot, T: robot.random_q(np.random.default_rng(0), HUGE),
        lambda robot, T: ik.benchmark(robot, ["lm"], targets=HUGE),
        lambda robot, T: ik.workspace(robot, targets=HUGE),
        lambda robot, T: ik.Shape.box((HUGE, 1, 1)),
        lambda robot, T: ik.Shape.sphere(HUGE),
        lambda robot, T: ik.CollisionModel(robot).add_cylinder(0.1, HUGE, T),
        lambda robot, T: ik.CollisionModel(robot).distances(robot.home, HUGE),
        lambda robot, T: ik.check_gains("cv", 0.01, kappa=1.0, null_damping=HUGE),
    ],
)
def test_a_whole_number_beyond_the_floats_is_an_invalid_option(call):
    with pytest.raises(InvalidOption, match=r" must be .*, not "):
        call(*good())


def test_counts_are_whole_numbers_however_they_are_written():
    robot, T = good()
    assert len(ik.solve_all(robot, T[:3, 3], starts=3.0, count=np.int64(2))) <= 2
    assert robot.random_q(np.random.default_rng(0), np.float64(4)).shape == (4, robot.n)
    for wrong in (2.5, "3", True, math.nan, [3], 0):
        with pytest.raises(InvalidOption, match="count must be a whole number of at least 1, not "):
            ik.solve_all(robot, T, count=wrong)
        with pytest.raises(InvalidOption, match="starts must be a whole number of at least 1, not "):
            ik.solve_all(robot, T, starts=wrong)


def test_lengths_in_messages_are_in_metres_where_they_are_long():
    far = ik.solve(load("two_arms"), {"left_tip": (1e5, 1.0, 0.0), "right_tip": (1e5, -1.0, 0.0)}, restarts=0)
    assert far.status == ik.Status.UNREACHABLE and "left_tip 100000 m" in far.message and "mm" not in far.message
    one = ik.solve(load(ARM), (1e5, 0.0, 0.0), restarts=0)
    assert "beyond reach by 100000 m" in one.message and "mm" not in one.message


@pytest.mark.parametrize(
    ("solver", "name"), [("lm", "damping"), ("dls", "damping"), ("pinv", "gain"), ("transpose", "gain")]
)
def test_a_negative_parameter_is_refused(solver, name):
    robot, T = good()
    for call, target in ((ik.solve, T), (ik.solve_batch, [T])):
        with pytest.raises(InvalidOption, match=f"'{solver}' needs a {name} of at least 0, not -3"):
            call(robot, target, solver, **{name: -3.0})


def test_an_error_says_whose_pose_is_wrong():
    robot = ik.Robot.load("hydrolek_7w")
    hand = (0.5, 0.1, 0.3, 0.0, 0.0, 0.0, 1.0)
    with pytest.raises(InvalidTarget, match=r"^a target must be .*shape \(7,\); .* ik\.pose\(xyz=, quat_xyzw=\)"):
        ik.solve(robot, hand)
    with pytest.raises(InvalidTarget, match=r"^the pose of a shape must be"):
        ik.CollisionModel(robot).add(ik.Shape.sphere(0.1), hand)
    with pytest.raises(InvalidTarget, match=r"^the pose of a tool must be"):
        robot.with_tool(hand)


class Table:
    """A table as of polars: it is an array of its rows for numpy, and gives its columns when it is iterated over."""

    def __init__(self, rows):
        self.rows = rows

    def __array__(self, dtype=None, copy=None):
        return np.array(self.rows, dtype=dtype)

    def __iter__(self):
        return iter(self.rows.T)

    def __len__(self):
        return len(self.rows)


@pytest.mark.parametrize("by_tip", [False, True])
def test_a_table_of_positions_is_read_by_rows(by_tip):
    robot = load(ARM)
    xyz = sample(robot, 3)[1][:, :3, 3]
    table = Table(xyz)
    many = ik.solve_batch(robot, {robot.tips[0]: table} if by_tip else table)
    assert many.success.all()
    assert np.allclose([robot.fk(q).translation for q in many.q], xyz, atol=1e-5)


def test_a_table_that_numpy_cannot_read_is_refused():
    class Elsewhere(Table):
        """A table that does not convert itself, as a tensor in the memory of a graphics card."""

        def __array__(self, dtype=None, copy=None):
            raise TypeError("copy it to host memory first")

        def __iter__(self):
            return iter([Elsewhere(self.rows)])

    with pytest.raises(InvalidTarget):
        ik.solve_batch(load(ARM), Elsewhere(np.zeros((2, 3))))
