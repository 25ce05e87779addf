"""Robots that are tracked in several files."""

import pytest
import robots


@pytest.fixture(scope="module")
def panda():
    return robots.load("panda")


@pytest.fixture(scope="module")
def planar():
    return robots.load("planar_2r")


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


@pytest.fixture(scope="module")
def tree():
    return robots.load("two_arms")
