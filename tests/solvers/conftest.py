"""A machine with two arms that is solved in several files."""

import pytest
import robots


@pytest.fixture(scope="session")
def brokk():
    """A Tree: two arms on one turret, with the tips left_tip and right_tip."""
    return robots.load("two_arms")
