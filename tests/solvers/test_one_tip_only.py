"""Calls for one tip reject a tree and say how to choose a tip."""

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.solvers.closed_form import describe_fit, fits
from ik_toolkit.study.singularity import measures


@pytest.fixture(scope="module")
def brokk():
    return ik.Tree.load("brokk_hydrolek")


def test_studies_of_one_tip(brokk):
    with pytest.raises(InvalidOption, match=r"needs one tip, .* left_tip, right_tip; choose one: ik.Robot.load"):
        measures(brokk, np.zeros(13))
    with pytest.raises(InvalidOption, match="takes a Robot"):
        measures("brokk_hydrolek", np.zeros(13))


def test_no_closed_form_fits_a_tree(brokk):
    assert describe_fit(brokk) == "" and fits(brokk, 0) is None and fits(ik.Tree(brokk.arms[:1]), 0) is None


def test_maps_and_calibrations_are_of_one_tip(brokk):
    T = np.eye(4)
    for call in (lambda: ik.reachability(brokk), lambda: ik.calibrate(brokk, T, T)):
        with pytest.raises(InvalidOption, match=r"needs one tip, .* left_tip, right_tip; choose one: ik.Robot.load"):
            call()
