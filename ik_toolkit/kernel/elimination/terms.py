"""Constants of the elimination: array sizes and thresholds, and the records that describe an ordering of the loop and an answer."""

from typing import NamedTuple

from ...compile.jit import compiled


class Verdicts(NamedTuple):
    """Status numbers in `Notes`: whether the list of joint solutions of a target is known to be complete."""

    certain: int = 0  # the list of solutions is certified to be complete
    double: int = 1  # roots of the determinant merge, as at a singular pose, so that two solutions may be one
    unsure: int = 2  # it is not known whether the list is complete
    family: int = 3  # there is a continuum of solutions


@compiled
class RootState(NamedTuple):
    """What is known of a root of the determinant: open (undecided), complex (no joint solution) or real (it has a solution)."""

    open: float = 0.0
    complex: float = 1.0
    real: float = 2.0
    settled: float = 3.0  # only while the roots are computed: this one has converged and is not iterated any more


@compiled
class Sizes(NamedTuple):
    """Sizes of the arrays used to find all joint solutions of an arm of six revolute joints."""

    numbers: int = 14  # how many numbers describe a line, see `equations.write_numbers`
    # number of monomials x4^i x5^j, i = 0 ... 3, j = 0 ... 2, where x = tan(q / 2); the index of one is 3 i + j
    monomials: int = 12
    degree: int = 14  # highest degree of the determinant, as a trigonometric polynomial, that is used
    samples: int = 33  # number of angles at which a determinant of this degree is evaluated: 2 degree + 5
    # rows of an answer: `Notes`, and up to 32 solutions (an arm has at most 16; others are copies or approximate)
    rows: int = 33
    # Numbers of a solution: q (6,), the gain (`closure.least_gain`), the root q3 [rad], and the range of a free angle. In place of
    # the root, a decomposition writes the position (from 1 on) of the angle that is free, or 0 if none is. The last number is by
    # how much that angle may turn either way [rad].
    columns: int = 9
    form: int = 7  # length of a `Form`, or of a `decomposition.Split`
    # length of the table of cos and sin of 2 pi k / K, the angles at which the determinant is evaluated
    tables: int = 66
    whole: int = 157  # length of a row of `forms` of `answer.solve_loops`: `form`, `tables` and 84 more numbers
    branches: int = 8  # largest number of branches (solutions) of a decomposition, from three square roots
    block: int = 4096  # length of the scratch memory [float64], more than `answer.make_work` needs


@compiled
class CertaintyThresholds(NamedTuple):
    """Thresholds that decide whether a list of joint solutions is certified as complete.

    Angles are in rad, lengths in units of the arm's size. The thresholds were tuned on 60 arms, and tested on 180,000 targets from
    other random seeds.
    """

    # the column of a monomial counts as zero below this share of the longest; rounding is 1e-16 at a condition number of 1e4
    empty: float = 1e-12
    # a pivot below this share of the largest is replaced by that share, so that null vectors can be computed
    faint: float = 1e-17
    sweeps: int = 40  # highest number of iterations over all roots; 8 are usual, close roots need 30
    # the iteration of a root ends when its relative step is below this, because such a step is rounding
    settled: float = 1e-14
    quiet: float = 1e-13  # the iteration of all roots ends when the largest relative step is below this
    # Factor in the radius of the error disc around a root z of P. Smith (1970) bounds the distance to the true root by 2 d |P(z)| /
    # |c prod (z - z_j)|. The error of P(z) is the measured noise, with random signs; four times the root of the sum of its squares
    # was never exceeded in 240,000 targets.
    disc: float = 4.0
    noisy: float = 1e-6  # a determinant with more noise than this relative to its largest coefficient is not used
    flat: float = 1e-11  # a determinant whose values are below this share of those at a typical target is not used
    # a root nearer to the unit circle than this may be two merging roots, so its error disc has to miss the circle more clearly
    band: float = 2e-3
    # a root further from the unit circle than `band` is complex if its error disc misses the circle by this many radii
    clear: float = 3.0
    # a root nearer to the unit circle than `band` is complex if its error disc misses the circle by this many radii
    clearer: float = 30.0
    wide: float = 5e-3  # an error disc with a larger radius certifies nothing
    # error discs count as overlapping if their centres are nearer than this many times the sum of the radii
    apart: float = 4.0
    # two roots may belong to two solutions with the same q3 only if their mean is this near the unit circle
    paired: float = 1e-6
    # the equations have two null vectors if their second smallest singular value is below this share of the largest
    second: float = 1e-3
    # two roots are complex only if the third smallest singular value is above this share of the largest
    third: float = 1e-3
    # two roots are complex only if the second smallest singular value is below this share of the largest
    second_complex: float = 1e-6
    closed: float = 1e-11  # largest error of a solution's pose [rad or arm sizes]
    steps: int = 30  # highest number of Newton steps from approximate angles to a solution
    longest: float = 0.7  # longest Newton step [rad]
    still: float = 1e-8  # Newton's method ends after a step below this [rad]; the error is then about its square
    # a solution's q3 may differ from the root it was found from by this much [rad], or by `kept_radii` if that is more
    kept: float = 1e-6
    kept_radii: float = 20.0  # a solution's q3 may differ from its root by this many radii of the root's error disc
    kept_most: float = 1e-2  # a solution's q3 may not differ from its root by more than this [rad] in any case
    # two solutions count as the same if no joint differs by more [rad]; at a singular pose see `account.tolerance`
    same: float = 1e-7
    # two roots may share a solution whose gain (about the least singular value of the Jacobian) is below this; the status is then
    # DOUBLE
    singular: float = 1e-3
    family: float = 1e-5  # a solution with a smaller gain may be one of a continuum, so the list is not certified


@compiled
class DecompositionThresholds(NamedTuple):
    """Thresholds that decide when the solutions of a decomposed arm get the status UNSURE.

    Angles are in rad, lengths in units of the arm's size.
    """

    rounding: float = 3e-15  # error assumed for every number if the arm decomposes exactly; errors of 1e-15 occur
    off: float = 1e-3  # axes count as meeting or parallel if they miss that by at most this [rad or arm sizes]
    band: float = 4.0  # true errors never exceed the estimated error times this factor
    # solutions that may be one, or may not exist, because of errors must be nearer to each other than this [rad]
    apart: float = 1e-3
    still: float = 1e-9  # an angle is free if it moves the point that determines it by less than this
    loose: float = 1e-5  # an angle counts as free only if the error of the numbers that decide it is below this
    # A pose displaced by e has complex solutions at most 30 sqrt(e) (`decide.MARGINS.gap`) from real ones. Complex solutions within
    # d of real ones therefore belong to displacements up to (d / 30)^2; twice that is used, about 2e-3 d^2.
    near: float = 2e-3
    # If axes are parallel or meet to within this [rad or arm sizes], a branch of the formulas has one solution at most.
    alike: float = 1e-12


VERDICT, STATE, SIZES, TRUST, DOUBT = Verdicts(), RootState(), Sizes(), CertaintyThresholds(), DecompositionThresholds()


class Form(NamedTuple):
    """An ordering of an arm's loop equation: which joint it begins at, its direction, and what is known of its determinant.

    The fields are the first numbers of a row of `forms` of `answer.solve_loops`. After SIZES.form numbers the row has cos and sin
    of the angles at which the determinant is evaluated, then `mix`, see `answer.Work`.
    """

    backwards: float  # 1 if the loop is reversed
    shift: float  # how many joints after the first one the reordered loop begins
    rank: float  # rank of the coefficients of the 8 products of cos and sin of joints 1 and 2
    degree: float  # degree of the determinant as a trigonometric polynomial
    largest: float  # scale of the determinant: its largest value over a turn of joint 3, median over random targets


class Notes(NamedTuple):
    """The first row of an answer: how many solutions it has, and whether the list is certified.

    The rows after it are the solutions.
    """

    count: float  # number of solutions
    status: float  # a number of `Verdicts`
    forms: float  # number of orderings of the loop equation that were tried; 0 if a decomposition has answered
    # number of roots of the determinant, for the ordering that certified the list or, if none did, the last one tried
    roots: float
    # number of roots that are proven complex; if the list is certified, each of the others is a solution
    complex: float
    radius: float  # radius of the largest error disc around a root that is not complex
    noise: float  # estimated error of the determinant's coefficients, relative to the largest
    near: float  # number of approximate solutions after the exact ones (`answer.list_near`); -1 if some are not listed
