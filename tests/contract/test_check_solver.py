"""`check_solver` catches solvers that break the contract: each fault is a rule that runs the real search and corrupts its rows."""

from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.kernel.records import AT, SIZE
from ik_toolkit.kernel.search import entry
from ik_toolkit.solvers.closed_form.geometry import Branches, Fit
from ik_toolkit.solvers.rules.jacobian import LM
from ik_toolkit.testing import CLAUSES, cases, check_solver

CALLS = []  # what the fault of memory keeps


def moves_the_target(out, T, Q0, history):
    T[:, 0, 3] += 1e-3


def moves_the_start(out, T, Q0, history):
    Q0[:] = 0.3


def leaves_the_limits(out, T, Q0, history):
    out[:, SIZE.answer] = 100.0


def understates_the_error(out, T, Q0, history):
    out[:, AT.position] *= 0.5


def claims_success(out, T, Q0, history):
    out[:, AT.status], out[:, AT.position] = ik.Status.CONVERGED, 0.0


def hides_success(out, T, Q0, history):
    out[:, AT.status] = ik.Status.STALLED


def remembers(out, T, Q0, history):
    CALLS.append(0)
    out[:, SIZE.answer :] += 1e-12 * len(CALLS)


def overspends(out, T, Q0, history):
    out[:, AT.evaluations] += 1000


def restarts_always(out, T, Q0, history):
    out[:, AT.restarts] += 1


def invents_history(out, T, Q0, history):
    history[:, 0] += 1e-3


def gives_no_number(out, T, Q0, history):
    out[out[:, AT.status] != ik.Status.CONVERGED, SIZE.answer :] = np.nan


def moves_held_joints(out, T, Q0, history):
    out[:, -1] += 1e-6


FAULTS = {
    fault.__name__: fault
    for fault in (
        moves_the_target, moves_the_start, leaves_the_limits, understates_the_error, claims_success, hides_success, remembers,
        overspends, restarts_always, invents_history, gives_no_number, moves_held_joints,
    )
}  # fmt: skip


@ik.rule(step=LM)
class Faulty(NamedTuple):
    """The default rule with a fault."""

    fault: str = ""

    def pack(self, robot, asked):
        return LM()

    def loop(self, robot):
        solve, spoil = entry(LM), FAULTS.get(self.fault, lambda *_: None)

        def loop(chain, T, Q0, out, orders):
            solve(chain, T, Q0, out, orders)
            filled = len(T) * (SIZE.answer + robot.n)
            spoil(out[:filled].reshape(len(T), -1), T, Q0, out[filled:].reshape(-1, SIZE.past + robot.n))

        return loop


def test_the_rule_without_a_fault_passes():
    check_solver(Faulty(), robots=["hydrolek_7w", robots.load("planar_2r")], seed=1)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_and_named(fault):
    with pytest.raises(AssertionError, match=r"^Faulty on planar_2r \(position\): .{20,}"):
        check_solver(Faulty(fault), robots=["planar_2r"])


@pytest.mark.parametrize("clause", CLAUSES)
def test_every_clause_is_broken_by_some_fault(clause):
    broken = 0
    for fault in FAULTS:
        (case,) = cases(Faulty(fault), [robots.load("planar_2r")])
        try:
            CLAUSES[clause](case)
        except (AssertionError, ik.IKError):
            broken += 1
    assert broken


FORM_FAULTS = {  # what a wrong closed form makes of the one true branch (1, 2) of the gantry: its list; and how it is told
    "true": (lambda q: q, ""),
    "twice": (lambda q: np.repeat(q, 2, axis=0), "it lists a solution twice"),
    "beyond": (lambda q: q, "a listed solution is outside the limits"),
}


@ik.closed_form
class Gantry(NamedTuple):
    """Two prismatic joints along x and y, as of the robot cartesian_pp, with a fault."""

    fault: str = "true"
    pose = False

    @staticmethod
    def recognise(chain):
        return Fit(np.zeros(0), "", 0.0)

    def pack(self, robot, asked):
        return np.zeros(0)

    def every(self, robot, p, T, box, count):
        J = robot.chain.forward(robot.home[None], jacobian=True)[1][0, :3]
        q = np.linalg.lstsq(J, T[:3, 3] - robot.fk(np.zeros(2)).translation)[0][None]
        broken = 0.0 if self.fault == "beyond" else max(0.0, *(box[0] - q[0]), *(q[0] - box[1]))
        q = FORM_FAULTS[self.fault][0](q)
        return Branches(q, np.full(len(q), broken), np.zeros((len(q), 3), dtype=np.int8), True, " of the gantry")


@pytest.mark.parametrize("fault", FORM_FAULTS)
def test_a_list_of_a_closed_form_is_checked(fault):
    says = FORM_FAULTS[fault][1]
    with pytest.raises(AssertionError, match=says) if says else nullcontext():
        check_solver(Gantry(fault), robots=["cartesian_pp"])


@ik.closed_form
class OneElbow(NamedTuple):
    """One of the two branches of a planar arm, as if there were no other."""

    pose = False

    @staticmethod
    def recognise(chain):
        return Fit(np.zeros(0), "", 0.0)

    def every(self, robot, p, T, box, count):
        q = ik.solve_all(robot, T[:3, 3], "planar-2r", q0=box[2], limits=False).q[:1]
        broken = np.maximum(box[0] - q, q - box[1]).max(axis=1, initial=0.0)
        return Branches(q, broken, np.zeros((len(q), 3), dtype=np.int8), True, " with one elbow")


def test_a_list_that_is_called_complete_must_be():
    with pytest.raises(AssertionError, match="a list called complete lacks a solution"):
        check_solver(OneElbow, robots=["planar_2r"])


@ik.rule(step=LM)
class Silent(NamedTuple):
    """A rule that refuses everything and barely says why."""

    words: str = ""

    def refuses(self, asked):
        return self.words


@pytest.mark.parametrize(
    ("words", "says"),
    [("no", "a refusal must say why"), ("is for robots with a soul, and this has none", "fits none of the")],
)
def test_a_rule_that_solves_nothing_does_not_pass(words, says):
    with pytest.raises(AssertionError, match=says):
        check_solver(Silent(words), robots=["planar_2r"])


@ik.rule(step=LM)
class Raising(NamedTuple):
    """A rule that fails while it is prepared."""

    gain: float = 1.0

    def pack(self, robot, asked):
        raise ZeroDivisionError("nothing there")


def test_an_exception_of_its_own_is_named():
    with pytest.raises(AssertionError, match="raises ZeroDivisionError: nothing there"):
        check_solver(Raising, robots=["planar_2r"])


def test_names_and_classes_that_are_no_solver_are_refused():
    for wrong in ("lmm", dict, 3):
        with pytest.raises(ik.IKError):
            check_solver(wrong)
