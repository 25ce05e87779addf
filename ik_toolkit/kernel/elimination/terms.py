"""The terms of the elimination: sizes of arrays, thresholds, and what a form and an answer consist of."""

from typing import NamedTuple

from ...compile.jit import compiled

CERTAIN, DOUBLE, UNSURE, FAMILY = 0, 1, 2, 3  # verdicts on an answer


@compiled
class RootState(NamedTuple):
    """States of a root."""

    open: float = 0.0
    complex: float = 1.0
    real: float = 2.0
    settled: float = 3.0  # only while roots are found


@compiled
class Sizes(NamedTuple):
    """Sizes of the arrays."""

    numbers: int = 14  # numbers of a line
    monomials: int = 12  # x4^i x5^j, i = 0 ... 3, j = 0 ... 2; the index is 3 i + j
    degree: int = 14  # highest degree of the determinant that is used
    samples: int = 33  # its values for that degree, 2 degree + 5
    rows: int = (
        33  # rows of an answer: the notes, and up to 32 solutions (an arm has 16 at most, the rest are repetitions)
    )
    # Numbers of a solution: q (6,), the gain of `closure.least_gain`, the root [rad]. Of a decomposition, for the root: 0, or
    # the number of the place whose angle is free, from 1 on, and by how much it may turn either way [rad].
    columns: int = 9
    form: int = 7  # numbers of a Form, or of a `decomposition.Split`
    tables: int = 66  # rows: cos, sin of 2 pi k / K
    arm: int = 52  # numbers of an arm, see `answer.solve_loops`
    whole: int = 157  # numbers of a form with its tables and `mix`
    branches: int = 8  # of a decomposition, from three square roots
    block: int = 4096  # numbers of scratch, more than `make_work` cuts


@compiled
class Trust(NamedTuple):
    """What an answer must meet to be called certain; angles [rad], lengths in sizes of the arm.

    The thresholds were tuned on 60 arms, and judged on 180,000 targets of other seeds.
    """

    empty: float = (
        1e-12  # a monomial's column shorter than this share of the longest is rounding, 1e-16 at a condition of 1e4
    )
    faint: float = (
        1e-17  # a smaller pivot, as a share of the largest, is replaced by that, so that null vectors come out
    )
    sweeps: int = 40  # highest number of sweeps for the roots; 8 are usual, clusters need 30
    settled: float = 1e-14  # a root whose relative step is smaller stays where it is: that is rounding
    quiet: float = 1e-13  # no sweep follows one whose largest relative step is smaller
    # Smith (1970) bounds the distance of a root by 2 d |P(z)| / |c prod (z - z_j)|. P(z) has the noise measured, with random signs;
    # four times the root of the sum of its squares was never passed in 240,000 targets.
    disc: float = 4.0
    noisy: float = 1e-6  # a determinant with more noise than this beside its largest coefficient says nothing
    flat: float = 1e-11  # the same of one whose values are below this share of a usual target's
    band: float = 2e-3  # a root nearer the circle may be a fold, so its disc has to miss the circle more clearly:
    clear: float = 3.0  # by so many radii outside the band,
    clearer: float = 30.0  # and by so many in it
    wide: float = 5e-3  # a disc of a larger radius places nothing
    apart: float = 4.0  # discs overlap if their centres are nearer than the sum of so many radii
    paired: float = 1e-6  # two roots are one double root of two solutions only if their mean is this near the circle
    second: float = 1e-3  # two null vectors: the second smallest singular value is below this share of the largest,
    third: float = 1e-3  # and, for two complex solutions, the third is above this share
    second_complex: float = 1e-6  # with the second below this share
    closed: float = 1e-11  # a solution closes the loop to this
    steps: int = 30  # highest number of Newton steps to it
    longest: float = 0.7  # longest of them
    still: float = 1e-8  # the last one is shorter than this, and Newton's method squares it
    kept: float = 1e-6  # the kept angle of a solution may differ this much from its root,
    kept_radii: float = 20.0  # or so many radii,
    kept_most: float = 1e-2  # but no more than this
    same: float = 1e-7  # solutions are the same if no joint differs by more; at a singular pose see `tolerance`
    singular: float = 1e-3  # two roots may share a solution whose gain is below this: DOUBLE
    family: float = 1e-5  # a solution with a smaller gain may be one of a continuum, so the answer is not certain


@compiled
class Doubt(NamedTuple):
    """When a decomposition must say that it is not sure; angles [rad], lengths in sizes of the arm."""

    rounding: float = 3e-15  # error of every number of an exact arm; 1e-15 occurs
    off: float = 1e-3  # axes that miss a structure by more do not have it
    band: float = 4.0  # so many errors are never passed
    apart: float = 1e-3  # solutions that may be one, or none, must be nearer than this
    still: float = 1e-9  # a point that moves by less as an angle changes leaves that angle free
    loose: float = 1e-5  # an angle is free only if the numbers that leave it so are exact to this
    # Poses within an error e have complex solutions at most 30 sqrt(e) from real ones (`decide.MARGINS.gap`): twice (1 / 30)^2
    near: float = 2e-3
    alike: float = 1e-12  # an arm that is off by less has no more solutions than branches


STATE, SIZES, TRUST, DOUBT = RootState(), Sizes(), Trust(), Doubt()


class Form(NamedTuple):
    """One way to read the loop, as found for a robot; the first numbers of its row, with the arrays of `Tables` after them."""

    backwards: float  # 1 if the loop is read backwards
    shift: float  # how many joints later it begins
    rank: float  # rank of the 8 monomials of joints 1 and 2
    degree: float  # degree of the determinant, without what is divided out
    largest: float  # usual size of the determinant's values


class Notes(NamedTuple):
    """What an answer says of itself; its first row, but for its last number."""

    count: float  # solutions
    status: float  # CERTAIN, DOUBLE or UNSURE
    forms: float  # forms that were tried; 0 if a decomposition has answered
    roots: float  # roots of the determinant of the last form
    complex: float  # those that are proven complex; if the answer is certain, each of the others is a solution
    radius: float  # radius of the largest disc of a real root
    noise: float  # noise of the determinant's coefficients beside the largest
    near: (
        float  # rows after the solutions that `answer.list_near` wrote, or -1 if there are others that it cannot write
    )
