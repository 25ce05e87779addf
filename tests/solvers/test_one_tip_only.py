"""What is for one tip says so to a tree, and how to choose one."""

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.solvers.closed_form import describe, fits
from ik_toolkit.study.singularity import measures


@pytest.fixture(scope="module")
def brokk():
    return ik.Tree.load("brokk_hydrolek")


def test_tracking_and_studies_of_one_tip(brokk):
    T = brokk.arms[0].fk(brokk.arms[0].home)
    for call in (
        lambda robot: ik.track(robot, ik.line(T, T, duration=1.0)),
        ik.Tracker,
        lambda robot: measures(robot, np.zeros(13)),
    ):
        with pytest.raises(InvalidOption, match=r"is for one tip, .* left_tip, right_tip; choose one: ik.Robot.load"):
            call(brokk)
        with pytest.raises(InvalidOption, match="takes a Robot"):
            call("brokk_hydrolek")


def test_no_closed_form_fits_a_tree(brokk):
    assert describe(brokk) == "" and fits(brokk, 0) is None and fits(ik.Tree(brokk.arms[:1]), 0) is None
