"""The kernel's kinematics against Pinocchio (the oracle); against the second FK see test_second_fk.py."""

import math

import numba
import numpy as np
import pytest
import robots

from ik_toolkit.compile.jit import cached
from ik_toolkit.kernel import starts
from ik_toolkit.kernel.algebra import at3, rotation_at, sincos

ALL = [*robots.SHIPPED, *robots.MADE, "locked", "tool", *(name for name, _ in robots.DATA_ARMS)]


def robot_or_skip(name):
    if name in dict(robots.DATA_ARMS) and not robots.have_data():
        pytest.skip("example-robot-data is not installed")
    return robots.load(name)


@pytest.mark.parametrize("name", ALL)
def test_forward_kinematics_and_jacobian_equal_pinocchio(name):
    robot = robot_or_skip(name)
    Q, T = robots.sample(robot, 200, seed=5)
    size = max(1.0, robot.reach)
    poses, jacobians = robot.chain.forward(Q, jacobian=True)
    assert np.abs(poses - T).max() < 1e-12 * size
    assert max(np.abs(robot.jacobian(q) - J).max() for q, J in zip(Q, jacobians, strict=True)) < 1e-12 * size


@cached
def _sincos(x, out):
    for i in range(x.shape[0]):
        s, c = sincos(x[i])
        out[i, 0] = s
        out[i, 1] = c


def test_sincos_is_exact_to_the_rounding_of_its_argument():
    x = np.concatenate([np.linspace(-30, 30, 20001), np.arange(-9, 10) * math.pi / 2, [6300.0, 3e5, -1e7, 1e9]])
    exact, out = np.column_stack([np.sin(x), np.cos(x)]), np.empty((len(x), 2))
    _sincos(x, out)
    assert (np.abs(out - exact).max(axis=1) < 1e-15 + 2e-16 * np.abs(x)).all()
    assert np.abs(out - exact)[:20001].max() < 2e-15


@cached
def _random(out):
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(88172645463325252)
    for i in range(out.shape[0]):
        out[i] = starts.rnd(state)


def test_random_sequence_is_uniform():
    out = np.empty(200_000)
    _random(out)
    assert 0.0 <= out.min() and out.max() < 1.0
    counts = np.histogram(out, bins=50, range=(0, 1))[0]
    assert ((counts - 4000) ** 2 / 4000).sum() < 100  # chi-squared with 49 degrees of freedom, 1e-5 tail is 99.9


def test_lengths_are_scaled_by_a_power_of_two():
    for name in ("planar_3r", "panda") if robots.have_data() else ("planar_3r",):
        chain = robots.load(name).chain
        assert math.frexp(chain.scale)[0] == 0.5
        assert 0.5 < chain.reach / chain.scale < 2.0


@numba.njit
def across(A):
    """A function of plain numba that calls parts of the kernel, and parts of parts."""
    return at3(A, 0).cross(rotation_at(A, 3).times(at3(A, 0))).square()


@cached
def doubled(A):
    return 2.0 * across(A)


def test_parts_are_linked_into_what_plain_numba_compiles():
    A = np.arange(1.0, 13.0)
    wanted = np.sum(np.cross(A[:3], A[3:].reshape(3, 3) @ A[:3]) ** 2)
    assert across(A) == pytest.approx(wanted, rel=1e-12)
    assert doubled(A) == pytest.approx(2.0 * wanted, rel=1e-12)
