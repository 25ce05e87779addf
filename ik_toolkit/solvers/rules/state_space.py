"""The state-space solver: a static linear system maps the error to joint increments; no Jacobian is evaluated.

Stability: along one direction of the task let kappa be the loop gain, an eigenvalue of J(q) C B (or of J(q) D). The error e falls
by kappa e when the linear map's increment for e is taken. With A = a I and the literal delay of eq. (14) (dq(k) = C x(k), where x
has not absorbed e(k) yet) the error has the characteristic equation z^2 - (1 + a) z + (a + kappa) = 0. By Jury's test it is stable
for 0 < kappa < 1 - a: kappa < 1.5 at the paper's a = -0.5 (1 without the delay), with both poles at 0.25 for kappa = 0.5625. A
feedthrough D alone has the pole z = 1 - kappa: stable for 0 < kappa < 2, fastest at 1.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import compiled
from ...errors import InvalidOption
from ...kernel.kinematics import TAU
from ...kernel.records import Array
from ...kernel.search import WAITING
from ..presets import check_starts, load_preset
from ..protocol import Asked, rule
from ..tuning_space import Parameter, Space, sampling_box, start_parameter

# For each system of units in which matrices may be given: units of error per metre, and radians per unit of joint increment.
UNITS = {"si": (1.0, 1.0), "mm-deg": (1000.0, np.pi / 180.0)}
# The array `numbers` of the compiled step (`Maps`) begins with HEAD numbers: the number of states, the number of linear maps (B,
# D), and two flags: whether there is a D, and whether each step chooses its map anew.
HEAD = 4
# C is not tuned but C_FIXED times the identity, because (A, B, C) and (TAT^-1, TB, CT^-1) are the same solver for any T.
C_FIXED = -0.05
SETTLED = 1e-13  # the state has settled if no component of it changes by more than this in a step


class MapDesign(NamedTuple):
    """Constants of the solver that is designed for a robot if the user gives no matrices: many starts, each with matrices B, D."""

    maps: int = 128  # number of starts, each with its matrices, of the solver that is designed for a robot
    tuned_maps: int = 32  # number of starts that `ik tune` tunes by default
    samples: int = 4096  # number of random configurations from which the starts are picked
    # The Jacobian is averaged around each start: joints vary by +- `spread` of their range, at most `radius` [rad, m over reach].
    spread: float = 0.15
    radius: float = 0.3
    damping: float = 0.1  # damping of the inverse of the averaged Jacobian, its columns multiplied by the joint ranges
    position_gain: float = 0.9  # share of an error that a step removes, for position targets; diverges at 2
    pose_gain: float = 0.6  # share of an error that a step removes, for pose targets


DESIGN = MapDesign()


@compiled
class Maps(NamedTuple):
    """The compiled step of Algorithm II, the state-space solver; a map is the pair of matrices (B, D) that belongs to one start.

    Between steps, p.desk.x keeps the state x (2 n numbers), the next state (2 n), and the number of the map in use (from 1 on).
    """

    # HEAD numbers; for each joint 1 / (2 pi) if its values count modulo 2 pi, else 0; A; C; start, B and D of each map
    numbers: Array

    JACOBIAN = False

    def nearest_map(self, q, first, width):
        """Return the index of the linear map whose start is nearest q (n,), angles modulo 2 pi.

        first: index in `numbers` where the maps begin; width: how many numbers each has.
        """
        numbers = self.numbers
        least, chosen = np.inf, 0
        for k in range(int(numbers[1])):
            distance = 0.0
            for i in range(q.shape[0]):
                d = q[i] - numbers[first + k * width + i]
                d -= TAU * np.rint(d * numbers[HEAD + i])
                distance += d * d
            if distance < least:
                least, chosen = distance, k
        return chosen

    def step(self, p, e):
        s, numbers = p.desk, self.numbers
        n = s.dq.shape[0]
        m, maps = int(numbers[0]), int(numbers[1])
        feedthrough = numbers[2] > 0.0
        a = HEAD + n
        c = a + m * m
        first = c + n * m
        width = n + 6 * m + (6 * n if feedthrough else 0)
        chosen = 0
        if maps > 1:
            chosen = int(s.x[4 * n]) - 1
            if chosen < 0 or numbers[3] > 0.0:
                chosen = self.nearest_map(s.q, first, width)
                s.x[4 * n] = chosen + 1
        b = first + chosen * width + n
        f = b + 6 * m
        p.stack(e)
        for i in range(n):
            u = 0.0
            for j in range(m):
                u += numbers[c + i * m + j] * s.x[j]
            if feedthrough:
                for k in range(6):
                    u += numbers[f + 6 * i + k] * s.y[k]
            s.dq[i] = u if s.w[i] > 0.0 else 0.0
        changed = 0.0
        for i in range(m):
            u = 0.0
            for k in range(6):
                u += numbers[b + 6 * i + k] * s.y[k]
            for j in range(m):
                u += numbers[a + i * m + j] * s.x[j]
            s.x[2 * n + i] = u
        for i in range(m):
            changed = max(changed, abs(s.x[2 * n + i] - s.x[i]))
            s.x[i] = s.x[2 * n + i]
        # The solver has not stalled while its state still changes, even if all joints rest at their limits.
        return WAITING if changed > SETTLED else 0


@rule(step=Maps)
class StateSpace(NamedTuple):
    """Algorithm II, a linear state-space solver: dq(k) = C x(k) + D e(k), x(k+1) = A x(k) + B e(k), x(0) = 0.

    The error e = target - actual is in base axes [m, rad], orientation as a rotation vector. Joints saturate at their
    limits; the state is not changed. If q0 is given, each step uses B and D of the start nearest the current q. Without
    any matrix, the solver is designed: 128 starts are spread over the workspace, and each has D = kappa times a damped inverse
    of the mean Jacobian around it. Source: Burrell et al. (2016), eqs. (14)-(15); several B and D, feedthrough and design are ours.

    Args:
        A: State matrix (m, m).
        B: Input matrix (m, 3) for positions or (m, 6) for poses, or one for each of M starts, (M, m, 3 or 6).
        C: Output matrix (n, m).
        D: Feedthrough (n, 3 or 6), or one for each start; the published solver has none.
        starts: Configurations (M, n) [rad, m]. Without q0 the one whose tip is nearest the target is used, and
            its B and D are used; restarts take the next nearest.
        units: "si", or "mm-deg" for the paper's (e in mm, increments in degrees; starts stay in rad).
        axes: Rotation (3, 3) from base axes to the axes in which B and D are meant.
        tuned: Options of the search that come with a preset.
    """

    A: Any = None
    B: Any = None
    C: Any = None
    D: Any = None
    starts: Any = None
    units: str = "si"
    axes: Any = None
    tuned: Any = None

    @classmethod
    def preset(cls, name: str | Path) -> "StateSpace":
        """Make the rule with published or tuned matrices, given by the name of a preset or the path of a preset file.

        Raises InvalidOption listing the presets.
        """
        values, options = load_preset("state-space", name, cls._fields)
        return cls(**values)._replace(tuned=options)

    def resolve(self, robot: Any, position_only: bool) -> "StateSpace":
        """Return this solver if it has matrices, else the one designed for the robot, which is computed once for each robot."""
        if any(part is not None for part in (self.A, self.B, self.C, self.D)):
            return self
        key = ("state-space design", position_only)
        if key not in robot.memo:
            starts = spread_starts(robot, position_only, DESIGN.maps)
            gain = DESIGN.position_gain if position_only else DESIGN.pose_gain
            robot.memo[key] = StateSpace(D=gain * inverse_maps(robot, starts, position_only), starts=starts)
        return robot.memo[key]

    @classmethod
    def space(
        cls, robot: Any, position_only: bool, initial: "StateSpace | None" = None, maps: int | None = None
    ) -> Space:
        """Return the parameters that `ik tune` searches, starting from `initial`: with maps=1 one start, and matrices A and B.

        With more maps (default 32) it searches their starts, with matrices designed for these, and a gain.
        """
        maps = DESIGN.tuned_maps if maps is None else maps
        if maps == 1:
            return _one_map(robot, position_only, initial)
        return _several_maps(robot, position_only, maps) if initial is None else _split(robot, maps, initial)

    def start_table(self, robot: Any, position_only: bool) -> np.ndarray | None:
        """Return start configurations (M, n) [rad or m] to choose from if no q0 is given; None: start at home."""
        starts = self.resolve(robot, position_only).starts
        return None if starts is None else check_starts("state-space", starts, robot)

    def pack(self, robot: Any, asked: Asked | None = None) -> np.ndarray:
        """Return the array that is the field `numbers` of the compiled step `Maps`, with lengths over the scale of the robot.

        Raises InvalidOption on wrong shapes.
        """
        position_only, given = (asked.position_only, asked.given) if asked is not None else (False, True)
        made = self.resolve(robot, position_only)
        if made.units not in UNITS:
            raise InvalidOption(f"state-space: units must be one of {', '.join(UNITS)}, not '{made.units}'")
        n, chain = robot.n, robot.chain
        given_matrices = [part is not None for part in (made.A, made.B, made.C)]
        if any(given_matrices) and not all(given_matrices):
            raise InvalidOption("state-space needs all of A, B and C, or none of them")
        A, C = np.zeros((0, 0)), np.zeros((n, 0))
        if all(given_matrices):
            A, C = (np.atleast_2d(np.asarray(part, dtype=float)) for part in (made.A, made.C))
        m = len(A)
        starts = made.start_table(robot, position_only)
        if starts is None:
            starts = np.zeros((1, n))
        M = len(starts)
        B = _maps(made.B, M, m, "B", position_only) if m else np.zeros((M, 0, 3))
        D = _maps(made.D, M, n, "D", position_only) if made.D is not None else np.zeros((M, 0, 3))
        if A.shape != (m, m) or C.shape != (n, m):
            raise InvalidOption(
                f"state-space: A (m, m), B (m, 3) or (m, 6), C ({n}, m) are needed; got {A.shape}, {B.shape[1:]}, {C.shape}"
            )
        if m > 2 * n:
            raise InvalidOption(f"state-space: at most {2 * n} states for {n} joints, got {m}")
        if not all(np.isfinite(part).all() for part in (A, B, C, D, starts)):
            raise InvalidOption("state-space: A, B, C, D and starts must be finite")
        per_metre, increment = UNITS[made.units]
        axes = np.asarray(chain.ends[:9]).reshape(3, 3)
        if made.axes is not None:
            axes = np.asarray(made.axes, dtype=float) @ axes
        to_kernel = increment / chain.unit[:, None]

        def full(maps: np.ndarray) -> np.ndarray:
            linear = maps[:, :, :3] @ axes * (per_metre * chain.scale)
            angular = maps[:, :, 3:] @ axes if maps.shape[2] == 6 else np.zeros_like(linear)
            return np.concatenate([linear, angular], axis=2)

        B, D = full(B), full(D) * (to_kernel if D.shape[1] else 1.0)
        table = np.concatenate([starts / chain.unit, B.reshape(M, -1), D.reshape(M, -1)], axis=1)
        head = [m, M, float(D.shape[1] > 0), float(given and M > 1)]
        turns = np.where(chain.turns > 0.0, 1.0 / TAU, 0.0)
        return np.concatenate([head, turns, A.ravel(), (C * to_kernel).ravel(), table.ravel()])


def _maps(maps: Any, count: int, rows: int, name: str, position_only: bool) -> np.ndarray:
    """Return the matrices B or D as an array (count, rows, 3 or 6), one per start. Raises InvalidOption on a wrong shape."""
    array = np.asarray(maps, dtype=float)
    if array.ndim not in (2, 3) or array.shape[-2] != rows or array.shape[-1] not in (3, 6):
        raise InvalidOption(f"state-space: {name} must have the shape ({rows}, 3) or ({rows}, 6), not {array.shape}")
    if array.ndim == 3 and len(array) != count:
        raise InvalidOption(f"state-space: {name} holds {len(array)} maps, and there are {count} starts")
    if array.shape[-1] == 3 and not position_only:
        raise InvalidOption(
            f"state-space: {name} has three columns, so it solves positions; a pose needs {name} ({rows}, 6)"
        )
    return np.broadcast_to(array, (count, rows, array.shape[-1]))


# ------------------------------------------------------------------------------------------------------------- design
def spread_starts(robot: Any, position_only: bool, count: int) -> np.ndarray:
    """Choose starts (count, n) [rad or m] all over the workspace, far from limits and singularities; a single one is home.

    The workspace is cut into cells by Lloyd's algorithm, each of which gets one start.
    """
    if count == 1:
        return robot.home[None].copy()
    rng = np.random.default_rng(0)
    chain = robot.chain
    low, width = sampling_box(robot)
    Q = low + width * rng.random((max(DESIGN.samples, 32 * count), robot.n))
    T, J = chain.forward(Q, jacobian=True)
    feature = T[:, :3, 3] / chain.scale
    J = J[:, : 3 if position_only else 6] * np.minimum(width, 2.0 * chain.unit)
    J[:, :3] /= chain.scale
    if not position_only:  # with the weight of the orientation in the table of starts that other solvers use
        feature = np.concatenate([feature, np.sqrt(0.05) * T[:, :3, :3].reshape(len(Q), 9)], axis=1)
    centre = feature[:count].copy()
    cell = np.zeros(len(Q), dtype=int)
    for _ in range(6):
        distance = (centre**2).sum(1) - 2.0 * feature @ centre.T
        cell = distance.argmin(1)
        size = np.bincount(cell, minlength=count)
        for k in range(feature.shape[1]):
            total = np.bincount(cell, feature[:, k], count)
            centre[:, k] = np.where(size > 0, total / np.maximum(size, 1), centre[:, k])
    values = np.linalg.svd(J, compute_uv=False)
    good = values[:, min(values.shape[1], _rank(values)) - 1]
    inner = np.minimum(4.0 * np.minimum(Q - low, low + width - Q) / np.where(width > 0.0, width, 1.0), 1.0)
    score = good * np.prod(np.maximum(inner, 0.04), axis=1) ** (1.0 / robot.n)
    away = ((feature - centre[cell]) ** 2).sum(1)
    starts = []
    for k in range(count):
        members = np.flatnonzero(cell == k)
        if len(members):
            near = away[members] / (np.median(away[members]) + 1e-12)
            starts.append(Q[members[np.argmax(score[members] * np.exp(-0.5 * near))]])
    return np.array(starts)


def _rank(values: np.ndarray) -> int:
    """Return the rank of the task: the number of singular values (N, r) that are nonzero at any configuration."""
    return max(1, int((values.max(axis=0) > 1e-9 * values.max()).sum()))


def inverse_maps(robot: Any, starts: np.ndarray, position_only: bool) -> np.ndarray:
    """Compute damped inverses (M, n, 3 or 6) [rad or m per m or rad] of the Jacobian averaged around each start (M, n)."""
    rng = np.random.default_rng(0)
    chain, n = robot.chain, robot.n
    low, width = sampling_box(robot)
    rows = 3 if position_only else 6
    radius = np.minimum(DESIGN.spread * width, DESIGN.radius * chain.unit)
    offsets = rng.uniform(-1.0, 1.0, (64, n)) * radius
    Q = np.clip(starts[:, None] + offsets, np.minimum(low, starts[:, None]), np.maximum(low + width, starts[:, None]))
    J = chain.forward(Q.reshape(-1, n), jacobian=True)[1].reshape(len(starts), 64, 6, n).mean(axis=1)[:, :rows]
    J[:, :3] /= chain.scale
    weight = np.minimum(width, 2.0 * chain.unit)  # With these weights, joints move in proportion to their range.
    W = J * weight
    inverse = np.swapaxes(W, 1, 2) @ np.linalg.inv(W @ np.swapaxes(W, 1, 2) + DESIGN.damping**2 * np.eye(rows))
    maps = inverse * weight[:, None]
    maps[:, :, :3] /= chain.scale
    return maps


# ------------------------------------------------------------------------------------------------------- what is tuned
def _one_map(robot: Any, position_only: bool, initial: StateSpace | None) -> Space:
    """Return the parameters of the published structure: A = a I, B, C = -0.05 I, literal delay, one start."""
    n, scale, unit = robot.n, robot.chain.scale, robot.chain.unit
    start = robot.home[None]
    # Tuning begins at a = -0.5 and a loop gain of 0.5625, with which both poles of the loop are at 0.25, so errors die out fast.
    if initial is None:
        B = 0.5625 / C_FIXED * inverse_maps(robot, start, position_only)[0]
        initial = StateSpace(A=-0.5 * np.eye(n), B=B, C=C_FIXED * np.eye(n), starts=start)
    a, B = _plain(initial, n)
    if initial.starts is not None:
        start = np.atleast_2d(np.asarray(initial.starts, dtype=float))[:1]
    size = np.concatenate([np.full(3, 1.0 / scale), np.ones(3)])[: B.shape[1]] * unit[:, None] / abs(C_FIXED)
    reach = np.maximum(1.5, 1.5 * np.abs(B / size).max()) * size

    def make(values: dict[str, Any]) -> StateSpace:
        return StateSpace(A=values["a"] * np.eye(n), B=values["B"], C=C_FIXED * np.eye(n), starts=values["starts"])

    parameters = (
        start_parameter(robot, start),
        Parameter("B", -reach, reach, B, "rad/m, 1"),
        Parameter("a", -0.95, 0.6, a),
    )
    return Space(parameters, initial, make)


def _plain(rule: StateSpace, n: int) -> tuple[float, np.ndarray]:
    """Return (a, B) [SI, base axes] of a rule with A = a I and C = c I, rescaled to C = -0.05 I.

    Raises InvalidOption.
    """
    A, B, C = (np.asarray(part, dtype=float) for part in (rule.A, rule.B, rule.C))
    if A.shape != (n, n) or C.shape != (n, n) or B.ndim != 2 or rule.D is not None:
        raise InvalidOption("the search can start from a rule with A (n, n), one B, C (n, n) and no D")
    a, c = A[0, 0], C[0, 0]
    if not (np.allclose(A, a * np.eye(n)) and np.allclose(C, c * np.eye(n)) and c != 0.0):
        raise InvalidOption("the search can start from a rule with A = a I and C = c I only")
    per_metre, increment = UNITS[rule.units]
    axes = np.eye(3) if rule.axes is None else np.asarray(rule.axes, dtype=float)
    B = np.concatenate([B[:, :3] @ axes * per_metre, B[:, 3:] @ axes if B.shape[1] == 6 else B[:, 3:]], axis=1)
    return float(a), B * (c * increment / C_FIXED)


def _several_maps(robot: Any, position_only: bool, maps: int) -> Space:
    """Return the starts as what is tuned; a start's matrix D is kappa times a damped inverse of the mean Jacobian around it."""
    starts = spread_starts(robot, position_only, maps)

    def make(values: dict[str, Any]) -> StateSpace:
        where = values["starts"]
        return StateSpace(D=values["kappa"] * inverse_maps(robot, where, position_only), starts=where)

    parameters = (
        start_parameter(robot, starts),
        Parameter("kappa", 0.2, 1.6, DESIGN.position_gain if position_only else DESIGN.pose_gain),
    )
    initial = make({"starts": starts, "kappa": parameters[1].initial})
    return Space(parameters, initial, make, spread=0.08)


def _split(robot: Any, maps: int, initial: StateSpace) -> Space:
    """Return the space of several starts to tune, for rules with A = a I, C = -0.05 I and the literal delay.

    Each start's B lies between the given one (share 0) and the one designed for that start (share 1).
    """
    n, eye = robot.n, np.eye(robot.n)
    a, B = _plain(initial, n)
    position_only = B.shape[1] == 3
    starts = spread_starts(robot, position_only, maps)

    def make(values: dict[str, Any]) -> StateSpace:
        where, share = values["starts"], values["share"]
        own = values["kappa"] / C_FIXED * inverse_maps(robot, where, position_only)
        return StateSpace(A=values["a"] * eye, B=(1.0 - share) * B + share * own, C=C_FIXED * eye, starts=where)

    parameters = (
        start_parameter(robot, starts),
        Parameter("share", 0.0, 1.0, 0.0),
        Parameter("kappa", 0.1, 1.4, 0.5625),  # with a = -0.5 and the initial value 0.5625 both poles are at 0.25
        Parameter("a", -0.95, 0.6, a),
    )
    return Space(parameters, initial, make)
