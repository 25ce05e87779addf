"""Measurement models of a calibration: residuals of measured poses, positions, distances and contacts, with derivatives.

Lengths are in m and angles in rad, in the frame of the measurements. Touched objects have unknowns of their own, z: the positions
of sockets and of the fixed end of a distance (3 each), and planes (two tilts of the normal and the distance, 3 each).
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InvalidOption, InvalidTarget, floats, whole
from ..robot.formats.finding import did_you_mean
from ..robot.pose import as_matrix
from ..text import length

# the kinds of measurement, and how many numbers each gives
WHAT = {"pose": 6, "position": 3, "distance": 1, "plane": 1, "socket": 3}
TOUCHED = {"socket": "sockets", "plane": "planes", "distance": "fixed ends"}
NOISE = (5e-4, 1e-3)  # [m, rad] default noise of a measurement
LEAST = 1e-6  # [m, rad] smallest noise that is assumed, whether estimated or given; no instrument is that precise
PRIOR = (0.01, 0.035)  # [m, rad] standard deviation assumed for the errors of links and joints
# Measured positions are not in metres if they spread over more than FAR times the arm's reach, or if 100 times their spread is less
# than that of the nominal arm's positions.
FAR = 10.0


class Measurements:
    """Measurements of the tip, all of one kind, as `calibrate` takes them.

    Attributes:
        what: The kind, a key of WHAT.
        per: Numbers that each measurement gives.
        labels: For each measurement (N,) the number of the socket, plane or fixed end, from 0; else 0.
        count: Number of sockets, planes or fixed ends.
        places: Known places (count, 3) [m], or None.
        pairs: Known distances [m] between two sockets, by the pair of their indices.
    """

    def __init__(self, what: str, measured: Any, places: Any = None, distances: Any = None) -> None:
        """Check and convert the arguments of `calibrate`. Raises InvalidTarget, InvalidOption."""
        if not isinstance(what, str) or what not in WHAT:
            raise InvalidOption(f"what must be one of {', '.join(WHAT)}, not {what!r:.60}.{did_you_mean(what, WHAT)}")
        self.what, self.per = what, WHAT[what]
        self.positions = self.rotations = self.lengths = np.empty(0)
        self.labels = np.zeros(len(measured) if hasattr(measured, "__len__") else 0, dtype=int)
        if what == "pose":
            T = _poses(measured)
            self.positions, self.rotations = T[:, :3, 3], T[:, :3, :3]
        elif what == "position":
            poses = "; for poses (N, 4, 4) give what='pose'" if np.shape(measured)[1:] == (4, 4) else ""
            self.positions = _rows(measured, 3, f"measured positions must have the shape (N, 3){poses}")
        elif what == "distance":
            rows = floats(measured, "measured distances must be numbers", InvalidTarget)
            form = "measured distances must be (N,), or (N, 2) with the end first"
            rows = _rows(rows if rows.ndim == 2 else rows[:, None], None, form)
            self.lengths = rows[:, -1]
            if not (self.lengths > 0.0).all():
                raise InvalidTarget(
                    f"a measured distance must be above 0 m; row {int((self.lengths <= 0.0).argmax())} is not"
                )
            self.labels = _labels(rows[:, 0] if rows.shape[1] == 2 else np.zeros(len(rows)), what)
        else:
            self.labels = _labels(measured, what)
        self.count = int(self.labels.max(initial=-1)) + 1 if what in TOUCHED else 0
        self.size = 3 * self.count
        self._read_known(places, distances)
        self._normals = np.empty((0, 3, 3))

    def _read_known(self, places: Any, distances: Any) -> None:
        self.places, self.pairs = None, {}
        if places is not None:
            if self.what not in ("socket", "distance"):
                raise InvalidOption(
                    f"places are those of sockets or of the fixed ends of distances; what is '{self.what}'"
                )
            self.places = _rows(places, 3, "places must have the shape (K, 3)")
            if len(self.places) != self.count:
                raise InvalidTarget(
                    f"places has {len(self.places)} rows; the measurements name {self.count} {TOUCHED[self.what]}, from 0"
                )
        if distances is None:
            return
        if self.what != "socket":
            raise InvalidOption(f"distances are those between sockets; what is '{self.what}'")
        if not isinstance(distances, dict):
            given = floats(distances, "distances must be one number, or a dict {(0, 1): metres}", InvalidOption)
            if given.shape != () or self.count != 2:
                raise InvalidOption(
                    f"one distance is for two sockets, here are {self.count}: give a dict {{(0, 1): metres}}"
                )
            distances = {(0, 1): float(given)}
        for pair, value in distances.items():
            length = floats(value, f"the distance {pair} must be a number", InvalidOption)
            known = (
                isinstance(pair, tuple) and len(pair) == 2 and tuple(sorted(pair)) in combinations(range(self.count), 2)
            )
            if not known or length.shape != () or not 0.0 < length < np.inf:
                raise InvalidOption(
                    f"distances take two different sockets of 0 to {self.count - 1} and metres, not {pair!r:.40}: {value!r:.40}"
                )
            one, two = sorted(pair)
            if self.pairs.setdefault((one, two), float(length)) != float(length):
                raise InvalidOption(
                    f"sockets {one} and {two} are given two distances, {self.pairs[one, two]:g} and {length:g} m"
                )

    def __len__(self) -> int:
        """Return the number of measurements."""
        return len(self.lengths if self.what == "distance" else self.labels)

    def taken(self, rows: np.ndarray | slice) -> "Measurements":
        """Return only the measurements `rows` (a mask, indices or a slice); sockets, planes or fixed ends keep their indices."""
        other = Measurements.__new__(Measurements)
        other.__dict__.update(vars(self))
        for name in ("positions", "rotations", "lengths", "labels"):
            array = getattr(self, name)
            setattr(other, name, array[rows] if len(array) else array)
        return other

    def require_metres(self, reach: float, drawn: np.ndarray) -> None:
        """Raise InvalidTarget if positions or distances spread so far, or so little, that they cannot be metres.

        drawn: tip positions (N, 3) [m] of the nominal arm in the measured configurations.
        """
        given = self.positions if len(self.positions) else self.lengths[:, None]
        spread = float(np.ptp(given, axis=0).max()) if len(given) else 0.0
        if spread > FAR * reach:
            raise InvalidTarget(
                f"the measurements spread over {spread:.4g} m, {spread / reach:.0f} times the robot's reach of {reach:.3g} m; were "
                "millimetres meant? Multiply by 0.001 (--length-unit mm)"
            )
        moved = float(np.ptp(drawn, axis=0).max())
        if len(self.positions) and 100.0 * spread < moved:
            raise InvalidTarget(
                f"the measurements spread over {length(spread)}, but the tip of the drawn arm moves over {length(moved)}; were "
                "they metres already? Give metres (--length-unit m)"
            )

    def sigma(self, noise: Sequence[float]) -> np.ndarray:
        """Return the standard deviation (per,) of the numbers that one measurement gives, for a noise (length [m], angle [rad])."""
        return np.array([noise[0]] * 3 + [noise[1]] * 3)[: self.per]

    # --------------------------------------------------------------------------------------------------------- errors
    def begun(self, T: np.ndarray) -> tuple["Measurements", np.ndarray]:
        """Return a copy for one fit that begins at tip poses T (N, 4, 4), and a first estimate of z there.

        The tilts of a plane count from the plane through the tip positions, whose normals the copy keeps.
        """
        p, made, z = T[:, :3, 3], self.taken(slice(None)), [np.empty(0)]
        each = [p[self.labels == k] for k in range(self.count)]
        if self.places is not None:
            z = [self.places.ravel()]
        elif self.what == "socket":
            z = [points.mean(0) for points in each]
        elif self.what == "distance":
            # A fixed end a at distance L from p satisfies |p|^2 - L^2 = 2 p a - |a|^2, which is linear in a and |a|^2.
            for k, points in enumerate(each):
                L = self.lengths[self.labels == k]
                A = np.column_stack([2.0 * points, -np.ones(len(points))])
                z.append(np.linalg.lstsq(A, (points**2).sum(1) - L**2, rcond=1e-6)[0][:3])
        elif self.what == "plane":
            made._normals = np.array([np.linalg.svd(points - points.mean(0))[2] for points in each])
            far = [N[2] @ points.mean(0) for N, points in zip(made._normals, each, strict=True)]
            z = [np.array([0.0, 0.0, d]) for d in far]
        return made, np.concatenate(z)

    def errors(self, T: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the residuals (N, per) [m, rad] of the measurements at tip poses T (N, 4, 4), and their derivatives.

        The derivatives are (N, per, 6) with respect to a motion of the tip in its own axes, and (N, per, Z) with respect to z.
        """
        p, R = T[:, :3, 3], T[:, :3, :3]
        N, here = len(T), z.reshape(-1, 3)[self.labels] if self.count else p
        E, D, Z = np.zeros((N, self.per)), np.zeros((N, self.per, 6)), np.zeros((N, self.per, len(z)))
        rows = np.arange(N)
        at = 3 * self.labels
        if self.what in ("pose", "position"):
            E[:, :3], D[:, :3, :3] = p - self.positions, R
        if self.what == "pose":
            for k, apart in enumerate(np.swapaxes(self.rotations, 1, 2) @ R):
                E[k, 3:] = pin.log3(apart)
                D[k, 3:, 3:] = pin.Jlog3(apart)
        elif self.what == "socket":
            E, D[:, :, :3] = p - here, R
            for i in range(3):
                Z[rows, i, at + i] = -1.0
        elif self.what == "distance":
            away = p - here
            length = np.linalg.norm(away, axis=1)
            unit = away / np.maximum(length, 1e-12)[:, None]
            E[:, 0], D[:, 0, :3] = length - self.lengths, np.einsum("ni,nij->nj", unit, R)
            for i in range(3):
                Z[rows, 0, at + i] = -unit[:, i]
        elif self.what == "plane":
            V = self._normals[self.labels]
            raw = V[:, 2] + here[:, :1] * V[:, 0] + here[:, 1:2] * V[:, 1]
            size = np.linalg.norm(raw, axis=1)[:, None]
            unit = raw / size
            height = np.einsum("ni,ni->n", unit, p)
            E[:, 0], D[:, 0, :3] = height - here[:, 2], np.einsum("ni,nij->nj", unit, R)
            for i in range(2):
                Z[rows, 0, at + i] = (
                    np.einsum("ni,ni->n", V[:, i], p) - height * np.einsum("ni,ni->n", V[:, i], unit)
                ) / size[:, 0]
            Z[rows, 0, at + 2] = -1.0
        return E, D, Z

    def known(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals (m,) [m] of the known positions and distances of sockets, given z, and their derivatives (m, Z)."""
        E, D = [], []
        if self.places is not None:
            E, D = [*(z - self.places.ravel())], [*np.eye(len(z))]
        places = z.reshape(-1, 3)
        for (a, b), far in self.pairs.items():
            apart = places[a] - places[b]
            row = np.zeros((self.count, 3))
            row[a] = apart / max(np.linalg.norm(apart), 1e-12)
            row[b] = -row[a]
            E.append(np.linalg.norm(apart) - far)
            D.append(row.ravel())
        return np.array(E), np.array(D).reshape(len(E), len(z))


def _rows(value: Any, width: int | None, what: str) -> np.ndarray:
    array = floats(value, what, InvalidTarget)
    if array.ndim != 2 or not len(array) or (width is not None and array.shape[1] != width) or array.shape[1] > 3:
        raise InvalidTarget(f"{what}, not {array.shape}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise InvalidTarget(f"row {bad[0]} of the measurements is not finite (counted from 0): leave it out, in q too")
    return array


def _poses(measured: Any) -> np.ndarray:
    try:
        each = list(measured)
    except TypeError:
        raise InvalidTarget(f"measured poses must have the shape (N, 4, 4), not {measured!r:.60}") from None
    T = []
    for k, one in enumerate(each):
        if np.shape(one) == (3,):
            raise InvalidTarget("measured has positions (N, 3), not poses (N, 4, 4): give what='position'")
        try:
            T.append(as_matrix(one))
        except InvalidTarget as error:
            raise InvalidTarget(f"measured pose {k} (counted from 0): {error}") from None
    return np.array(T).reshape(-1, 4, 4)


def _labels(value: Any, what: str) -> np.ndarray:
    array = floats(value, f"measured must be (N,) numbers of the {TOUCHED[what]}, from 0", InvalidTarget)
    if array.ndim != 1 or not len(array):
        raise InvalidTarget(
            f"measured must be (N,), the number of the {what} each row touches, not the shape {array.shape}"
        )
    labels = np.array([whole(x, f"the number of a {what}", 0) for x in array.tolist()])
    missing = next((k for k in range(int(labels.max())) if k not in labels), None)
    if missing is not None:
        raise InvalidTarget(f"no measurement names {what} {missing}; number the {TOUCHED[what]} from 0 without gaps")
    return labels


def read_noise(noise: Any) -> tuple[float, float] | None:
    """Return the standard deviation (length [m], angle [rad]) of the noise as given, None to estimate it. Raises InvalidOption."""
    if noise is None:
        return None
    pair = floats(noise, "noise must be a length [m], or (length [m], angle [rad])", InvalidOption).ravel().tolist()
    if len(pair) not in (1, 2) or not all(LEAST <= one < np.inf for one in pair):
        raise InvalidOption(
            f"noise must be a length [m], or (length [m], angle [rad]), of at least {LEAST:g}; not {noise!r:.60}"
        )
    return pair[0], pair[-1] if len(pair) == 2 else 1e-3


def prior_spread(prior: Any) -> tuple[float, float]:
    """Return the expected size of link and joint errors (length [m], angle [rad]), as given or PRIOR. Raises InvalidOption."""
    if prior is None:
        return PRIOR
    pair = floats(prior, "prior must be (length [m], angle [rad])", InvalidOption)
    if pair.shape != (2,) or not ((pair > 0.0) & (pair < np.inf)).all():
        raise InvalidOption(f"prior must be (length [m], angle [rad]), both above 0; not {prior!r:.60}")
    return float(pair[0]), float(pair[1])
