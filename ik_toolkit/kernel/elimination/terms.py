"""Constants of the elimination: array sizes and thresholds, and the records that describe an ordering of the loop and an answer."""

from typing import NamedTuple

from ...compile.jit import compiled


class Verdicts(NamedTuple):
    """What is known of the list of solutions of a target: the status numbers in `Notes`."""

    certain: int = 0  # the list of solutions is complete
    double: int = 1  # roots merge, as at a singular pose, so two solutions may be one
    unsure: int = 2  # it is not known whether the list is complete
    family: int = 3  # there is a continuum of solutions


@compiled
class RootState(NamedTuple):
    """What is known of a root of the determinant: undecided (open), of no real solution (complex), or of one (real)."""

    open: float = 0.0
    complex: float = 1.0
    real: float = 2.0
    settled: float = 3.0  # only while the roots are being computed: the iteration of this root has ended


@compiled
class Sizes(NamedTuple):
    """Sizes of the arrays that the elimination uses."""

    numbers: int = 14  # how many numbers describe a line, see equations.py
    monomials: int = 12  # number of monomials x4^i x5^j, i = 0 ... 3, j = 0 ... 2; the index of one is 3 i + j
    degree: int = 14  # highest degree of the determinant that is used
    samples: int = 33  # number of angles at which the determinant is evaluated if it has that degree, 2 degree + 5
    # rows of an answer: `Notes`, and up to 32 solutions (an arm has 16 at most, the rest are repetitions)
    rows: int = 33
    # Numbers of a solution: q (6,), the gain (`closure.least_gain`), the root q3 [rad], and the range of a free angle. In place of
    # the root, a decomposition writes the position (from 1 on) of the angle that is free, or 0 if none is. The last number is by
    # how much that angle may turn either way [rad].
    columns: int = 9
    form: int = 7  # length of a `Form`, or of a `decomposition.Split`
    # length of the table of cos and sin of 2 pi k / K, the angles at which the determinant is evaluated
    tables: int = 66
    whole: int = 157  # length of a row of `forms` of `answer.solve_loops`: Form, tables and `mix`
    branches: int = 8  # largest number of branches (solutions) of a decomposition, from three square roots
    block: int = 4096  # length of the scratch memory, more than `make_work` needs


@compiled
class CertaintyThresholds(NamedTuple):
    """Thresholds that an answer must meet to be called certain; angles in rad, lengths in units of the arm's size.

    The thresholds were tuned on 60 arms, and tested on 180,000 targets from other random seeds.
    """

    # a monomial's column below this share of the longest is zero; rounding is 1e-16 at a condition of 1e4
    empty: float = 1e-12
    # a pivot below this share of the largest is replaced by that share, so that null vectors can be computed
    faint: float = 1e-17
    sweeps: int = 40  # highest number of iterations over all roots; 8 are usual, close roots need 30
    # the iteration of a root ends when its relative step is below this, because such a step is rounding
    settled: float = 1e-14
    quiet: float = 1e-13  # the iteration of all roots ends when the largest relative step is below this
    # Factor of the radius of an error disc. Smith (1970) bounds the distance of a root by 2 d |P(z)| / |c prod (z - z_j)|. The
    # error of P(z) is the measured noise, with random signs; four times the root of the sum of its squares was never exceeded in
    # 240,000 targets.
    disc: float = 4.0
    noisy: float = 1e-6  # a determinant with more noise than this relative to its largest coefficient is not used
    flat: float = 1e-11  # a determinant whose values are below this share of those at a usual target is not used
    # a root nearer to the unit circle than this may be two merging roots, so its error disc has to miss the circle more clearly
    band: float = 2e-3
    # a root further from the unit circle than `band` is complex if its error disc misses the circle by this many radii
    clear: float = 3.0
    # a root nearer to the unit circle than `band` is complex if its error disc misses the circle by this many radii
    clearer: float = 30.0
    wide: float = 5e-3  # an error disc with a larger radius certifies nothing
    # error discs count as overlapping if their centres are nearer than this many times the sum of the radii
    apart: float = 4.0
    # two roots belong to two solutions with one q3 only if their mean is this near the unit circle
    paired: float = 1e-6
    # there are two null vectors if the second smallest singular value is below this share of the largest
    second: float = 1e-3
    third: float = 1e-3  # two complex solutions need a third smallest singular value above this share of the largest
    # two complex solutions need a second smallest singular value below this share of the largest
    second_complex: float = 1e-6
    closed: float = 1e-11  # largest error with which the loop of a solution may close [rad, or arm sizes]
    steps: int = 30  # highest number of Newton steps from approximate angles to a solution
    longest: float = 0.7  # longest Newton step [rad]
    still: float = 1e-8  # Newton's method ends after a step below this [rad]; the error is then about its square
    # a solution's q3 may differ from its root by this much [rad], or by `kept_radii` if that is more
    kept: float = 1e-6
    kept_radii: float = 20.0  # a solution's q3 may differ from its root by this many radii of the root's error disc
    kept_most: float = 1e-2  # a solution's q3 may not differ from its root by more than this [rad] in any case
    # two solutions are the same if no joint differs by more [rad]; at a singular pose see `account.tolerance`
    same: float = 1e-7
    # two roots may share a solution whose gain (about the least singular value) is below this; the answer is then DOUBLE
    singular: float = 1e-3
    family: float = 1e-5  # a solution with a smaller gain may be one of a continuum, so the answer is not certain


@compiled
class DecompositionThresholds(NamedTuple):
    """Thresholds that decide when a decomposition must report UNSURE; angles in rad, lengths in units of the arm's size."""

    rounding: float = 3e-15  # error of every number of an arm that decomposes exactly; errors of 1e-15 occur
    off: float = 1e-3  # axes count as meeting, or as parallel, if they differ from that by at most this
    band: float = 4.0  # true errors never exceed the estimated error times this factor
    # two solutions that may be one, or none, because of errors must be nearer to each other than this [rad]
    apart: float = 1e-3
    still: float = 1e-9  # a point that moves by less as an angle changes leaves that angle free
    loose: float = 1e-5  # an angle counts as free only if the numbers that make it so are exact to this
    # A pose displaced by e has complex solutions at most 30 sqrt(e) (`decide.MARGINS.gap`) from real ones. Complex solutions within
    # d of real ones therefore belong to displacements up to (d / 30)^2; twice that is used, about 2e-3 d^2.
    near: float = 2e-3
    # If axes are parallel or meet to within this [lengths over the reach, rad], a branch of the formulas has one solution at most.
    alike: float = 1e-12


VERDICT, STATE, SIZES, TRUST, DOUBT = Verdicts(), RootState(), Sizes(), CertaintyThresholds(), DecompositionThresholds()


class Form(NamedTuple):
    """One ordering of the loop: the first numbers of a row of `forms` of `answer.solve_loops`.

    After SIZES.form numbers the row has cos and sin of the angles at which the determinant is evaluated, then `mix`, see
    `answer.Work`.
    """

    backwards: float  # 1 if the loop is reversed
    shift: float  # the reordered loop begins this many joints later
    rank: float  # rank of the coefficients of the 8 monomials of joints 1 and 2
    degree: float  # degree of the determinant as a trigonometric polynomial
    largest: float  # the determinant's largest value at a pose, as the median over random poses


class Notes(NamedTuple):
    """The first row of an answer: how many solutions it has, and whether the list is certified.

    The rows after it are the solutions.
    """

    count: float  # number of solutions
    status: float  # a number of `Verdicts`
    forms: float  # number of orderings of the loop that were tried; 0 if a decomposition has answered
    # number of roots of the determinant, for the ordering that certified the list, or else for the last one tried
    roots: float
    # number of roots that are proven complex; if the list is certified, each of the others is a solution
    complex: float
    radius: float  # radius of the largest error disc of a real root
    noise: float  # noise of the determinant's coefficients relative to the largest
    near: float  # number of approximate solutions after the exact ones (`answer.list_near`), or -1 if these are not listed
