"""Result of a calibration: errors with intervals, the corrected robot, residuals, and which poses to measure next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InvalidConfiguration, ModelError, floats
from ..files import as_output, write_whole
from ..robot.formats.convert import corrected_robot
from ..robot.formats.dh import DHTable
from ..robot.robot import Robot
from ..solvers.explain.dh_table import dh_of
from ..text import Tabled, TextTable, length
from .calibration_fit import ArmFit
from .calibration_report import open_points, page
from .drawn_arm import DrawnArm, Unknown
from .suggest_poses import chosen_poses

# A residual above MIXED_UP times the reach is too large to be credible: errors of 5 mm and 1 degree at every joint of four arms
# cause only 0.006 to 0.047.
MIXED_UP = 0.05
# An error is hardly determined by the data if its standard deviation exceeds UNSURE times the one assumed beforehand (prior).
UNSURE = 0.7


class FixedUnknown(NamedTuple):
    """An error fixed at 0, because the data do not depend on it or cannot tell it from the errors named in `shared`."""

    fixed: str
    shared: tuple[str, ...]


@dataclass(repr=False, eq=False)
class Calibration(Tabled):
    """Result of `calibrate`: how an arm differs from its nominal model ("as drawn").

    Lengths in metres, angles in radians; each error is in the axes of its joint's own frame (of the URDF), before the joint moves.
    """

    drawn: Robot  # the nominal robot, as it was given
    what: str  # what was measured: 'pose', 'position', 'distance', 'plane' or 'socket'
    parameters: tuple[str, ...]  # which errors were looked for: those of joints, frames, tool, base
    unknowns: tuple[Unknown, ...]  # names, groups and kinds of all P unknowns
    x: np.ndarray  # (P,) the errors that were found [m or rad]; 0 for fixed unknowns
    spread: np.ndarray  # (P, P) covariance of the errors x, zero for fixed unknowns
    fixed: tuple[FixedUnknown, ...]  # unknowns fixed at their nominal values, and those they cannot be separated from
    rank: int  # number of unknowns that the data determine
    rank_drawn: int  # number of unknowns that the data would determine at the nominal arm
    rank_anywhere: int  # number of unknowns that measurements spread over the arm's whole range would determine
    noise: tuple[float, float]  # standard deviation of the measurements [m, rad], as given or estimated
    # (N,) residual of each measurement if the nominal arm is assumed [m]; a base of unknown pose is placed where it fits best
    before: np.ndarray
    after: np.ndarray  # (N,) residuals for the corrected arm [m]
    # (2, N) orientation residuals [rad] of measured poses, for the nominal and for the corrected arm; empty for other measurements
    turned: np.ndarray
    held_out: float | None  # RMS residual [m] of measurements left out of the fit (5-fold cross-validation)
    outliers: tuple[int, ...]  # indices of the measurements that were left out of the fit
    # {joint whose sign is opposite to the model's: error with all these joints reversed, as a share of the error before}
    reversed: dict[str, float]
    width: float  # a 95 % interval reaches this many standard deviations to either side
    # observability index O1 of Borm and Menq (1989): geometric mean of the singular values of the scaled Jacobian, over sqrt(N)
    observability: float
    # condition number of the scaled Jacobian of the fitted unknowns: largest over smallest singular value
    condition: float
    touched: np.ndarray  # (K, 3) estimated positions of sockets or fixed ends [m], base frame
    prior: tuple[
        float, float
    ]  # size [m, rad] of the errors expected before measuring (standard deviations of the prior)
    T_world_base: np.ndarray  # (4, 4) pose of the base in the frame of the measurements
    notes: tuple[str, ...]  # sentences on what the data do not determine and on what is unusual
    converged: bool  # whether the last least-squares fit converged
    spread_all: np.ndarray  # (P, P) covariance of all unknowns, as if none were fixed
    signs: np.ndarray  # (n,) 1, or -1 for a joint that turns in the direction opposite to the model's
    q: np.ndarray  # (N, n) joint values of the measurements

    @classmethod
    def of(
        cls,
        fit: ArmFit,
        before: np.ndarray,
        fixed: Sequence[FixedUnknown],
        ranks: Sequence[int],
        prior: Any,
        against: Mapping[str, Any],
    ) -> "Calibration":
        """Make the Calibration, with all statistics, from a finished fit.

        before: residuals (N, 3 or 6) [m, rad] of the nominal arm. fixed: unknowns that were fixed. ranks: `rank`, `rank_drawn` and
        `rank_anywhere`. prior: standard deviations of the prior [m, rad]. against: the dict `reversed`.
        """
        arm, data = fit.arm, fit.measured
        after, converged = fit.errors(fit.x, fit.z), fit.converged
        A = fit.weighted(fit.x, fit.z, fit.kept)[1][:, : len(fit.x)][:, fit.free]
        S = np.linalg.svd(A, compute_uv=False)
        O1 = float(np.exp(np.log(np.maximum(S, 1e-300)).mean()) / np.sqrt(fit.kept.sum())) if len(S) else 0.0
        out = fit.held_out()
        turned = [np.linalg.norm(E[:, 3:], axis=1) for E in (before, after)]
        corrections = arm.corrections(fit.x)
        made = cls(
            drawn=arm.robot,
            what=data.what,
            parameters=arm.groups,
            unknowns=arm.unknowns,
            x=fit.x,
            spread=fit.spread(),
            fixed=tuple(fixed),
            rank=ranks[0],
            rank_drawn=ranks[1],
            rank_anywhere=ranks[2],
            noise=(float(fit.noise[0]), float(fit.noise[1])),
            before=np.linalg.norm(before[:, :3], axis=1),
            after=np.linalg.norm(after[:, :3], axis=1),
            turned=np.array(turned) if data.what == "pose" else np.empty((2, 0)),
            held_out=None if out is None else float(np.sqrt(np.nanmean(out**2))),
            outliers=tuple(np.flatnonzero(~fit.kept).tolist()),
            reversed=dict(against),
            width=fit.width(),
            observability=O1,
            condition=float(S[0] / S[-1]) if len(S) and S[-1] > 0.0 else np.inf,
            touched=fit.z.reshape(-1, 3) if data.what in ("socket", "distance") else np.empty((0, 3)),
            prior=tuple(prior),
            T_world_base=corrections.get(-1, pin.SE3.Identity()).homogeneous,
            notes=(),
            converged=converged,
            spread_all=fit.spread(every=True),
            signs=arm.sign.copy(),
            q=fit.Q.copy(),
        )
        made.notes = tuple(open_points(made, data.places is not None, len(data.pairs), fit.given))
        return made

    # ---------------------------------------------------------------------------------------------------- what it says
    @property
    def names(self) -> tuple[str, ...]:
        """Names of the errors that the data determine."""
        fixed = {one.fixed for one in self.fixed}
        return tuple(one.name for one in self.unknowns if one.name not in fixed)

    @property
    def unsure(self) -> tuple[str, ...]:
        """Names of the errors that the data hardly determine: their interval is about as wide as before measuring."""
        loose = np.sqrt(np.diag(self.spread)) > UNSURE * self._arm().scales(*self.prior)
        return tuple(one.name for one, is_loose in zip(self.unknowns, loose, strict=True) if is_loose)

    @property
    def implausible(self) -> tuple[str, ...]:
        """Names of the errors, except those of the base, that exceed three standard deviations of what was expected (prior)."""
        far = np.abs(self.x) > 3.0 * self._arm().scales(*self.prior)
        return tuple(one.name for one, is_far in zip(self.unknowns, far, strict=True) if is_far and one.group != "base")

    @property
    def credible(self) -> bool:
        """Whether the fit converged, no error is implausible, and the remaining residual is below 5 % of the reach.

        If not, rows, units, labels or the robot are probably mixed up, and the corrected robot is not to be used.
        """
        return self.converged and not self.implausible and self.rms[1] < MIXED_UP * self.drawn.reach

    @property
    def errors(self) -> dict[str, tuple[float, float]]:
        """Each error [m or rad] by name, with the half width of its 95 % interval; fixed unknowns are left out."""
        half = self.width * np.sqrt(np.diag(self.spread))
        every = {one.name: (float(x), float(h)) for one, x, h in zip(self.unknowns, self.x, half, strict=True)}
        return {name: every[name] for name in self.names}

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean square residuals [m] of the nominal and of the corrected arm, without the outliers."""
        kept = np.setdiff1d(np.arange(len(self.after)), self.outliers)
        return float(np.sqrt((self.before[kept] ** 2).mean())), float(np.sqrt((self.after[kept] ** 2).mean()))

    def _arm(self) -> DrawnArm:
        return DrawnArm(self.drawn, self.parameters, self.signs)

    def fk(self, q: Any) -> pin.SE3:
        """Compute the corrected arm's tip pose [m] at measured joint values q (n,) [rad or m], in the frame of the measurements."""
        return pin.SE3(self._arm().poses(self.x, self.drawn.check_q(q)[None])[0])

    def predict(self, q: Any) -> tuple[np.ndarray, np.ndarray]:
        """Compute positions (N, 3) [m] of the tip at q (N, n) [rad or m], and the half widths (N, 3) of their 95 % intervals.

        The intervals are those of the arm's errors, without the noise of a measurement.
        """
        Q = np.atleast_2d(floats(q, "q must be numbers", InvalidConfiguration))
        if Q.ndim != 2 or Q.shape[1] != self.drawn.n or not np.isfinite(Q).all():
            raise InvalidConfiguration(f"q must be (N, {self.drawn.n}) finite numbers, not of shape {Q.shape}")
        T, J = self._arm().evaluate(self.x, Q)
        moved = T[:, :3, :3] @ J[:, :3]
        return T[:, :3, 3], self.width * np.sqrt(
            np.maximum(np.einsum("nij,jk,nik->ni", moved, self.spread_all, moved), 0.0)
        )

    # ------------------------------------------------------------------------------------------------ corrected robot
    @property
    def robot(self) -> Robot:
        """The corrected robot: its description with the errors included, except that of the base (see T_world_base).

        Raises ModelError if the robot has no URDF.
        """
        arm = self._arm()
        C = arm.corrections(self.x)
        model = self.drawn.model
        joints = {model.names[j]: T.homogeneous for j, T in C.items() if j > 0}
        tool = C.get(0, pin.SE3.Identity()).homogeneous
        against = [model.names[j] for j, i in self.drawn._path.owner.items() if self.signs[i] < 0.0]
        return corrected_robot(self.drawn, joints, against, tool)

    @property
    def dh(self) -> DHTable | None:
        """The classic Denavit-Hartenberg table of the corrected robot; None for mimic joints, and without a URDF.

        Where axes that were drawn parallel are not quite so, their common normal may be far away, and d large.
        """
        try:
            return dh_of(self.robot)
        except ModelError:
            return None

    def write(self, path: str | Path) -> Robot:
        """Write the corrected robot as one plain URDF. Returns the robot; load the file with the name of its tip."""
        made = self.robot
        made.write(path)
        return made

    def suggest(self, count: int, *, avoid_collisions: Any = True, seed: int = 0) -> np.ndarray:
        """Choose configurations (count, n) [rad or m] whose measurement would reduce the remaining uncertainty most."""
        known = np.linalg.inv(self.spread_all + np.diag(1e-18 * np.ones(len(self.x))))
        return chosen_poses(
            self._arm(), self.x, known, count, self.what, self.noise, self.prior, avoid_collisions, seed
        )

    # ----------------------------------------------------------------------------------------------------------- text
    def table(self) -> TextTable:
        """Return a table of the errors that the data determine, with their 95 % intervals."""
        kinds, rows = {one.name: one.turns for one in self.unknowns}, []
        for name, (x, half) in self.errors.items():
            turns = kinds[name]
            rows.append((name, f"{shown(x, turns)} +- {shown(half, turns).lstrip('+')} {'deg' if turns else 'mm'}"))
        before, after = self.rms
        out = f", held out {length(self.held_out)}" if self.held_out is not None else ""
        words = f"{len(self.after)} measurements ({self.what}): {length(before)} as drawn, {length(after)} corrected{out} (RMS)"
        return TextTable(
            self.drawn.name, words, ("error", "95 % interval"), rows, self._fixed_words(), *self.notes, most=100
        )

    def _fixed_words(self) -> str:
        if not self.fixed:
            return ""
        return f"fixed as drawn, because it cannot be told from others: {', '.join(one.fixed for one in self.fixed)}"

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration as plain numbers, strings and lists."""
        names = "what rank rank_drawn rank_anywhere held_out observability condition converged credible".split()
        lists = "unsure noise outliers notes T_world_base touched".split()
        errors = {name: {"value": x, "half_width_95": half} for name, (x, half) in self.errors.items()}
        return {
            "robot": self.drawn.name,
            **{name: getattr(self, name) for name in names},
            **{name: np.array(getattr(self, name)).tolist() for name in lists},
            **dict(zip(("rms_before", "rms_after"), self.rms, strict=True)),
            "errors": errors,
            "fixed": {one.fixed: list(one.shared) for one in self.fixed},
            "reversed": sorted(self.reversed),
        }

    def save(self, path: str | Path) -> Path:
        """Write a self-contained HTML page: residuals before and after, errors, and what the data do not determine."""
        file = as_output(path, "a report", ".html", ".htm")
        write_whole(file, page(self))
        return file


def shown(value: float, turns: bool) -> str:
    """Return an error as text with its sign: a length [m] in mm or, if it is an angle (`turns`) [rad], in degrees."""
    return f"{np.degrees(value) if turns else 1e3 * value:+.3f}"
