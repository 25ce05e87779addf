"""Robots that are tracked in several files."""

import pytest

import ik_toolkit as ik


@pytest.fixture(scope="module")
def panda():
    return ik.Robot.load("panda")


@pytest.fixture(scope="module")
def planar():
    return ik.Robot.load("planar_2r")
