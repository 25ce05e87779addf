"""Joints that turn back again and again gain speed only gradually, so that they do not chatter."""

import numpy as np
import pytest

from ik_toolkit.servo.viability import BIT, CALMING, RateBox, calm, watch


@pytest.mark.parametrize("gamma", [0.5, 0.6, 1.0])
@pytest.mark.parametrize("h", [0.001, 0.004, 0.01, 0.03])
def test_calmed_joints_turn_at_most_three_times_in_a_tenth_of_a_second(h, gamma):
    """Where they are asked to turn back as soon as they can, or now and then; at 5 % of their speed limit and more."""
    rng, n = np.random.default_rng(8), 10
    size, turns = np.linspace(0.2, 3.0, n), [[] for _ in range(n)]
    swings, rate, side = np.zeros((3, n)), np.zeros(n), np.zeros(n)
    for k in range(max(round(2.0 / h), 500)):
        back = rng.random(n) < 0.5 if k // 100 % 2 else k % np.arange(1, n + 1) == 0  # at random, or in turn
        wish = np.where(back == (side > 0.0), -size, size)
        low, top, why = -size, size.copy(), np.zeros((2, n), np.uint8)
        calm(rate, size, swings, h, RateBox(low, top, *why))
        before, rate = rate, np.clip(wish, low, top)
        watch(swings, before, rate, size, gamma, h)
        move = (1.0 - gamma) * before + gamma * rate
        now = np.sign(move) * (np.abs(move) > 0.05 * size)
        for joint in np.flatnonzero(now * side < 0.0):
            turns[joint].append(k)
        side = np.where(now == 0.0, side, now)
    assert all(len(at) > 8 for at in turns)
    assert min((np.array(at[3:]) - at[:-3]).min() for at in turns) * h >= 0.1 - 1e-9


def test_a_calm_box_is_a_part_of_the_box():
    rng = np.random.default_rng(4)
    for _ in range(500):
        rate, size, h = rng.uniform(-1.0, 1.0, 4), rng.uniform(0.1, 30.0, 4), 0.01
        low = rng.uniform(-1.0, 1.0, 4)
        top = low + np.maximum(rng.uniform(-0.2, 1.0, 4), 0.0)
        floor, roof, why = low.copy(), top.copy(), rng.choice([1, 2, 4, 1 | BIT.recovering], (2, 4)).astype(np.uint8)
        swings = np.array([rng.integers(0, 5, 4), np.zeros(4), np.zeros(4)])
        code, more = why.copy(), 1.0 + CALMING.growth * h
        gain = np.where(swings[0] < CALMING.reversals, np.inf, CALMING.gain * size * h)
        calm(rate, size, swings, h, RateBox(floor, roof, *code))
        for least in (rate, 0.0 * rate):  # what changes least, and rest
            near = np.clip(least, low, top)
            assert (floor <= near).all() and (near <= roof).all()
        assert np.allclose(floor, np.clip(more * np.minimum(rate, 0.0) - gain, low, top), atol=1e-15)
        assert np.allclose(roof, np.clip(more * np.maximum(rate, 0.0) + gain, low, top), atol=1e-15)
        for side, moved in ((0, floor > low), (1, roof < top)):
            assert ((code[side] & BIT.calmed) > 0).tolist() == moved.tolist()
            assert (code[side][~moved] == why[side][~moved]).all()
            assert ((code[side] & BIT.recovering) == (why[side] & BIT.recovering)).all()
