"""One step of a tracker: the effect of limits, signs of multipliers."""

from types import SimpleNamespace

import numpy as np
import pytest
from constrained import law

from ik_toolkit.servo import equality_qp, hierarchical_qp, loop
from ik_toolkit.servo.constrained_step import CAUTION, MODE, make_room
from ik_toolkit.servo.viability import BIT
from ik_toolkit.servo.workspace import STATE, bench_on, bench_space


def bench(n, m, rows=3):
    return bench_on(np.zeros(bench_space(n, m, rows)), n, m, rows)


def given(mode, roof=0.5, h=0.1, plane=None, want=None, mu=0.0):
    """A step of six joints that each move one error; the first may go half as fast as is wanted."""
    n = 6
    s, state = bench(n, n), np.zeros(len(STATE))
    s.J[:], s.size[:], s.weight[:], s.heavy[:], s.floor[:], s.roof[:] = np.eye(n), 1.0, 1.0, 1.0, -2.0, 2.0
    s.why_low[:], s.why_top[:] = 2, 1
    s.roof[0] = roof
    s.x[:] = np.ones(n) if want is None else want
    count = 0
    if plane is not None:
        s.planes[0], s.edges[0], count = plane[0], plane[1], 1
    if mu > 0.0:  # a step down
        s.ask[:], s.size[:], s.even[:], s.x[:] = s.x, 7.0, 1.0, 0.0
    code, own = (
        np.zeros(n, np.uint8),
        SimpleNamespace(active=np.zeros(n, np.int8), kept=np.zeros(3, np.int8), state=state),
    )
    held = loop.by_constraints(law(mode=mode, rows=float(count)), s, count, mu, h, own, make_room(n, n, 3), code)
    assert own.kept.tolist() == [k < count and bool(abs(s.planes[k] @ s.x - s.edges[k]) < 1e-9) for k in range(3)]
    return held, s.x, code, own.active


def test_what_limits_make_of_the_rates_wanted():
    for mode in (MODE.leave, MODE.direct):
        held, x, code, _ = given(mode, 1.5)
        assert not held and not code.any()
        np.testing.assert_array_equal(x, 1.0)
        held, x, code, active = given(mode, mu=0.3)
        assert held and code.tolist() == [1, 0, 0, 0, 0, 0] and active[0] == 1
        np.testing.assert_allclose(x, [0.5, *[1.0 / 1.3] * 5], atol=1e-12)
    held, x, code, active = given(MODE.leave)
    assert held and code.tolist() == [1, 0, 0, 0, 0, 0] and active[0] == 1
    damped = 1.0 / (1.0 + CAUTION.bend * 0.1 * 0.5)  # by what is left, 0.5
    np.testing.assert_allclose(x, [0.5, *[damped] * 5], atol=1e-9)
    row = np.array([0.0, 0.1, 0.0, 0.9, 0.0, 0.0])
    held, x, code, active = given(MODE.leave, 2.0, plane=(row, 0.3))
    assert held and code.tolist() == [0, 0, 0, BIT.row, 0, 0] and row @ x == pytest.approx(0.3)
    held, x, code, _ = given(MODE.leave, 2.0, want=np.array([1.0, 1, 1, 1, 1, -3.0]))
    assert held and code[5] == 2 and x[5] == -2.0 and BIT.recovering == 16
    row = np.array([0.0, 0.1, 0.0, -0.9, 0.0, 0.0])  # the joint that the row holds most, whichever way
    held, x, code, _ = given(MODE.leave, 2.0, plane=(row, -1.0))
    assert held and code.tolist() == [0, 0, 0, BIT.row, 0, 0] and row @ x == pytest.approx(-1.0)


# ----------------------------------------------------------------------------------------------------------- two levels


def test_signs_and_shares_of_multipliers():
    for one, two, side, want in (
        (0.5, -9.0, 1, 0.0), (-0.5, 9.0, 1, 1.5), (0.5, 0.0, -1, 1.5), (0.0, 0.3, 1, 0.0), (0.0, -0.3, 1, 0.3), (0.0, 3.0, -1, 1.0),
        (0.0, -0.9e-11, 1, 0.0), (0.0, -1.1e-11, 1, 1.1e-11), (0.0, 0.0, 1, 0.0),
    ):  # fmt: skip
        assert hierarchical_qp.wrong(one, two, side) == pytest.approx(want, rel=1e-12)
    for now, new, want in (
        ((1.0, 2.0), (3.0, -9.0), (2.0, 0.0)), ((1.0, 2.0), (-1.0, 4.0), (0.5, (2.0 + 0.5 * 2.0) / 2.0)),
        ((0.0, 2.0), (0.0, -2.0), (0.5, 0.0)),
    ):  # fmt: skip
        assert hierarchical_qp.share(*(equality_qp.Pair(*np.array(one)[:, None]) for one in (now, new)), 0, 1) == want
    now, new = (equality_qp.Pair(*np.array(one)[:, None]) for one in ((0.0, -2.0), (0.0, 2.0)))
    assert hierarchical_qp.share(now, new, 0, -1) == (0.5, 0.0)
    p = equality_qp.program_on(np.zeros(equality_qp.program_space(2, 1)), 2, 1)
    p = equality_qp.resized(p, 2, 1, 0)
    p.P[0], p.rhs[0], p.floor[:], p.roof[:] = 1.0, 1.8, -1.0, 1.0
    for y, want in (((0.5, 1.4), (2, 1)), ((-1.4, 0.5), (1, -1)), ((0.95, 0.95), (0, 1))):
        p.y[:] = y
        assert hierarchical_qp.violated(p) == want
    p.active[0] = 1
    assert hierarchical_qp.violated(p) == (equality_qp.NONE, 0)
    p.roof[:], p.y[:] = (1e9, 0.0), (1e4, 3e-12)
    assert hierarchical_qp.violated(p) == (equality_qp.NONE, 0), "the rounding of a large unknown"
    p.y[1] = 3e-8
    assert hierarchical_qp.violated(p) == (2, 1)
    p.y[:] = 0.5, 3e-12
    assert hierarchical_qp.violated(p) == (2, 1)
