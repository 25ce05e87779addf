"""Targets of a control loop: the twist between them, and whether they stand."""

import numpy as np
import pinocchio as pin
import pytest

from ik_toolkit.servo import workspace
from ik_toolkit.servo.target_stream import ARRIVAL, GIVEN, STAND, arrive


def turned(rng, tips, angle):
    """Poses (F, 4, 4), and others turned by an angle and moved."""
    first = np.array([pin.SE3.Random().homogeneous for _ in range(tips)])
    second, axes = first.copy(), rng.normal(size=(tips, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    for T, axis in zip(second, axes, strict=True):
        T[:3, :3] = pin.exp3(angle * axis) @ T[:3, :3]
        T[:3, 3] += rng.normal(size=3)
    return first, second, angle * axes


def unknown(tips):
    """Nothing is known of where a target stands."""
    return np.concatenate([np.eye(len(STAND))[STAND.jumped], np.zeros(16 * tips)])


def arrived(samples, T, slot=1, how=GIVEN.doubtful, posed=-1, first=0, moved=0, V=None, A=None, dt=0.1, stand=None):
    """What `arrive` says of targets T (F, 4, 4)."""
    given = workspace.new_samples(1, len(T))
    given.T[0] = T
    given.V[0], given.A[0] = 0.0 if V is None else V, 0.0 if A is None else A
    stand = unknown(len(T)) if stand is None else stand
    return arrive(samples.block, given.block, stand, slot, how, posed, first, moved, V is not None, A is not None, dt)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 0.9e-4, 1.1e-4, 1e-3, 0.3, 2.5, 3.1])
def test_without_a_twist_it_is_that_from_the_last_target_to_the_next(angle):
    pin.seed(3)
    rng, samples = np.random.default_rng(3), workspace.new_samples(2, 2)
    last, now, turn = turned(rng, 2, angle)
    assert arrived(samples, last, first=1) == GIVEN.fine
    assert not samples.V.any() and np.array_equal(samples.T[0], last)
    assert arrived(samples, now, moved=1) == GIVEN.fine
    assert np.array_equal(samples.T[0], last) and np.array_equal(samples.T[1], now)
    V = samples.V[1].reshape(2, 2, 3)
    np.testing.assert_allclose(V[:, 0], (now - last)[:, :3, 3] / 0.1, rtol=1e-12)
    np.testing.assert_allclose(V[:, 1], turn / 0.1, atol=1e-13 if angle < 0.2 else 1e-11)
    assert arrived(samples, now, moved=1) == GIVEN.fine
    assert not samples.V[1].any()  # exactly: a target at rest


def standing(way, dt=0.01):
    """What is known of a target that moves along x, sample by sample."""
    samples, stand, T, told = workspace.new_samples(2, 1), unknown(1), np.eye(4)[None], []
    for k, x in enumerate(way):
        T[0, 0, 3] = x
        assert arrived(samples, T, first=k == 0, moved=k > 0, dt=dt, stand=stand) == GIVEN.fine
        told.append({name: stand[at] for name, at in STAND._asdict().items()})
    return told


def test_whether_a_target_stands():
    first, *_, last = standing([0.3] * 20)
    assert first["jumped"] and first["still"] and first["seconds"] == 0.0, (
        "before its first motion it counts as having jumped"
    )
    assert last["jumped"] and last["seconds"] == pytest.approx(0.19)
    *_, there, after = standing([0.0, 1.5 * ARRIVAL.jump, 1.5 * ARRIVAL.jump])
    assert there["jumped"] and not there["still"] and after["jumped"] and after["still"]
    steps = np.arange(40) * ARRIVAL.still * 0.01 / ARRIVAL.wait
    assert last["rest"] == pytest.approx(0.2) and after["rest"] == pytest.approx(0.01) and there["rest"] == 0.0
    slow, fast = (standing(pace * steps)[-1] for pace in (0.9, 1.5))
    assert slow["still"] and slow["jumped"] and slow["seconds"] < ARRIVAL.wait, "it creeps"
    turning = standing(1e-3 * np.cos(np.linspace(-1.0, 1.0, 41)))  # from one way to the other, within 0.5 mm
    assert turning[-1]["still"] and turning[-1]["seconds"] > ARRIVAL.wait > max(one["rest"] for one in turning), (
        "it turns back"
    )
    assert not fast["still"] and not fast["jumped"] and fast["seconds"] < ARRIVAL.wait
    trembling = standing(np.concatenate([2.0 * steps, 2.0 * steps[-1] + 0.1 * ARRIVAL.still * (-1.0) ** np.arange(30)]))
    assert (
        not trembling[45]["still"]
        and trembling[-1]["still"]
        and not trembling[-1]["jumped"]
        and trembling[-1]["rest"] == 0.0
    )


def test_what_is_no_pose_is_doubtful_and_what_is_not_finite_is_held_against():
    pin.seed(5)
    rng, samples = np.random.default_rng(5), workspace.new_samples(2, 2)
    last, now, _ = turned(rng, 2, 0.5)
    arrived(samples, last, first=1)
    for r, c in np.ndindex(4, 4):
        for off in (1e-8, np.nan, np.inf):
            bad = now.copy()
            bad[1, r, c] += off
            if c == 3 and r < 3 and off == 1e-8:
                continue
            assert arrived(samples, bad) == (GIVEN.refused if c == 3 and r < 3 else GIVEN.doubtful), (r, c, off)
    mirrored = now.copy()
    mirrored[0, :3, 2] *= -1.0
    assert arrived(samples, mirrored) == GIVEN.doubtful and arrived(samples, mirrored, how=GIVEN.fine) == GIVEN.fine
    broken = np.array([0.0, 0.0, np.nan, *np.zeros(9)])
    for what in ({"how": GIVEN.refused}, {"V": broken}, {"A": broken}):
        assert arrived(samples, now) == GIVEN.fine
        assert arrived(samples, now, **what) == GIVEN.refused
        assert np.array_equal(samples.T[0], last) and np.array_equal(samples.T[1], last)
        assert not samples.V[1].any() and not samples.A[1].any()
