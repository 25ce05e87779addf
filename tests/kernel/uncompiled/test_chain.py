"""The arrays of a chain: reach, full turns, the table of starts."""

import math

import numpy as np
import pytest
import random_arms as arms

from ik_toolkit.kernel.chain import segments, without_limits, without_wrap
from ik_toolkit.kernel.records import POINTS, Ends
from ik_toolkit.kernel.starts import DISTANCE, SEEDS

MIXES = ("tttstt", "tmtsnt", "stotmt", "tt")


@pytest.mark.parametrize("kinds", MIXES)
def test_reach_and_scale_of_a_chain(kinds):
    rng = np.random.default_rng(7)
    chain, rows, base, tip = arms.arm(rng, kinds)
    box, n = Ends(chain.ends, chain.n), chain.n
    assert math.frexp(chain.scale)[0] == 0.5 and 2**-0.5 <= chain.reach / chain.scale <= 2**0.5
    half = []
    for row in rows:
        k = int(row[8])
        far = [row[7] + row[6] * x for x in (chain.lower[k], chain.upper[k])]
        half.append(np.hypot(np.hypot(row[2], row[3]), np.abs(far).max()))
    np.testing.assert_allclose(segments(rows, chain.lower, chain.upper)[1:], half[1:], rtol=1e-13)
    tool = np.linalg.norm(tip[:3, 3])
    stroke = abs(rows[0, 6]) * (chain.upper - chain.lower)[int(rows[0, 8])]
    assert chain.reach == pytest.approx(sum(half[1:]) + tool + stroke)
    assert box.bound(0) * chain.scale == pytest.approx(sum(half[1:]) + tool)
    assert box.bound(2) * chain.scale == pytest.approx(sum(half[1:]))
    for _ in range(100):  # the bounds hold
        q = rng.uniform(chain.lower, chain.upper)
        pose, frames = arms.fk(rows, base, tip, q)
        lift = (
            np.sort([rows[0, 7] + rows[0, 6] * x for x in (chain.lower[0], chain.upper[0])])
            if rows[0, 6]
            else [rows[0, 7]] * 2
        )
        np.testing.assert_allclose([box.bound(4) * chain.scale, box.bound(5) * chain.scale], lift, rtol=1e-13)
        foot = frames[0][:3, 3]
        for point, reach, hole in ((pose[:3, 3], 0, 1), (frames[-1][:3, 3], 2, 3)):
            out = np.linalg.norm(point - foot) / chain.scale
            assert box.bound(hole) - 1e-12 <= out <= box.bound(reach) + 1e-12
    free = Ends(without_limits(chain.rows, chain.ends, n), n)
    assert (free.bound(0) == np.inf) == bool(rows[1:, 6].any()) or kinds[0] == "s"
    np.testing.assert_array_equal(free.flat[: POINTS + 7 * n + 1], chain.ends[: POINTS + 7 * n + 1])


def test_what_may_wrap():
    rng = np.random.default_rng(3)
    rows, n, _ = arms.table(rng, "ttstmt")
    wide = np.array([9.0, 2 * math.pi, 9.0, 6.0, np.inf])
    chain = arms.packed(rows, np.eye(4), np.eye(4), -0.5 * wide, 0.5 * wide)
    # a leader of another joint, a slide, less than a turn: not
    np.testing.assert_array_equal(chain.turns, [0, 1, 0, 0, 1])
    box = Ends(chain.ends, n)
    assert [box.turns(i) for i in range(n)] == [0, 1, 0, 0, 2] and not chain.plain
    assert box.upper(4) == -box.lower(4) == 10.0 * math.pi and box.upper(1) == math.pi
    assert box.unit(2) == chain.scale and box.unit(0) == 1.0 and box.upper(2) == 4.5 / chain.scale
    kept = Ends(without_wrap(chain.ends, n), n)
    assert [kept.turns(i) for i in range(n)] == [0, 0, 0, 0, 2] and box.turns(1) == 1
    rows, n, _ = arms.table(rng, "ttt")
    rows[1, 4] = -1.0
    chain = arms.packed(rows, np.eye(4), np.eye(4), np.full(n, -4.0), np.full(n, 4.0), np.ones(n))
    np.testing.assert_array_equal(chain.turns, [1, 0, 1])
    assert chain.seeds.shape == (SEEDS, n) and np.all(np.abs(chain.seeds) <= 4.0) and np.abs(chain.seeds).max() > 3.9
    assert Ends(chain.ends, n).home(1) == 1.0
    nothing = rows.copy()
    nothing[:, [2, 3, 7]] = 0.0
    chain = arms.packed(nothing, np.eye(4), np.eye(4), np.full(n, -4.0), np.full(n, 4.0), np.ones(n))
    assert chain.reach == chain.scale == 1.0


def test_features_of_the_table_of_starts():
    rng = np.random.default_rng(4)
    chain, rows, _, tip = arms.arm(rng, "tttstt")
    for k in (0, 17, 255):
        q = chain.seeds[k] * chain.unit
        pose, frames = arms.fk(rows, np.eye(4), tip, q)
        point = pose[:3, 3] / chain.scale
        near = DISTANCE.from_home * np.sum((q / chain.unit - chain.ends[POINTS + 36 : POINTS + 42]) ** 2)
        want = [*(-2.0 * point), *(-0.1 * frames[-1][:3, :3].ravel()), point @ point + near]
        np.testing.assert_allclose(chain.features[:, k], want, atol=1e-5)
