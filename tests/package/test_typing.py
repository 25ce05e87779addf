"""The options known to editors and type checkers are those the calls accept."""

import typing

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.robot.pose import AxisTarget, Matrix, Position
from ik_toolkit.solvers.options import NAMES, AllOptions, BatchOptions, SolveOptions
from ik_toolkit.solvers.rows import ROWS


def test_every_option_is_told_and_no_parameter_that_no_solver_has():
    """A new rule need not be told of here; an editor then takes its parameters on an instance of it."""
    parameters = {field for row in ROWS for field in row.load()._fields}
    told = set(SolveOptions.__annotations__)
    assert {"tolerance", *NAMES} <= told <= {"tolerance", *NAMES} | parameters


@pytest.mark.parametrize(
    ("call", "told"),
    [(call, SolveOptions) for call in (ik.solve, ik.Solver.__init__)]
    + [(ik.solve_all, AllOptions), (ik.solve_batch, BatchOptions)],
)
def test_the_calls_take_what_is_told(call, told):
    assert call.__annotations__["options"] == typing.Unpack[told]
    named = set(call.__annotations__) - {"options"}
    assert not named & set(told.__annotations__)  # a name cannot be both


def test_the_type_of_a_pose_goes_by_what_is_given():
    told = {tuple(o.__annotations__): o.__annotations__["return"] for o in typing.get_overloads(ik.pose)}
    assert told["xyz", "return"] is Position and told["xyz", "direction", "axis", "return"] is AxisTarget
    given = {"rpy": (0, 0, 0), "quat_xyzw": (0, 0, 0, 1), "quat_wxyz": (1, 0, 0, 0), "rotation": np.eye(3)}
    for name, value in given.items():
        assert told["xyz", name, "return"] is Matrix and ik.pose((1, 0, 0), **{name: value}).shape == (4, 4)
    assert ik.pose((1, 0, 0)).shape == (3,) and isinstance(ik.pose(direction=(0, 0, 1)), AxisTarget)
