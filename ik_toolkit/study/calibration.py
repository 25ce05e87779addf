"""What a calibration found: errors with intervals, the corrected robot, residuals, and which poses to measure next."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InvalidConfiguration, floats
from ..files import as_path, write_whole
from ..robot.formats.convert import corrected_robot
from ..robot.robot import Robot
from ..style import COLOURS, GREY, PALE
from ..text import TextTable, figure, length
from .calibration_fit import Fit
from .drawn_arm import DrawnArm, Unknown
from .measurements import WHAT
from .suggest_poses import chosen_poses

ROUGH = 0.005  # [m] errors left that no instrument makes
FEW = 2.2  # numbers measured for each error, below which outliers cannot be told well
UNSURE = 0.7  # of the prior's spread: an error known no better is mostly assumed
TOUCH = {
    "pose": "",
    "position": "the direction in which the tool points is not measured",
    "distance": "the base frame is free: distances from places that are not known fix no directions",
    "socket": "the base frame and the scale are free: all lengths may be longer by one factor; measure the distance of two sockets",
    "plane": "the base frame and the scale are free, because the planes are not known",
}


class Convention(NamedTuple):
    """An unknown that was fixed as drawn, because the data do not tell it from the others named, if any."""

    fixed: str
    shared: tuple[str, ...]


@dataclass(repr=False, eq=False)
class Calibration:
    """How an arm differs from its drawing.

    Lengths in metres, angles in radians; each error is in the axes of its joint's own frame (of the URDF), before the joint moves.
    """

    drawn: Robot  # the robot as it was given
    what: str  # what was measured
    parameters: tuple[str, ...]  # groups of unknowns: joints, frames, tool, base
    unknowns: tuple[Unknown, ...]  # names, groups and kinds of all P unknowns
    x: np.ndarray  # (P,) the errors; 0 for those fixed
    spread: np.ndarray  # (P, P) their covariance, zero for those fixed
    fixed: tuple[Convention, ...]  # unknowns fixed as drawn, and what they cannot be told from
    rank: int  # number of unknowns that the data tell
    rank_drawn: int  # the same, evaluated at the drawn arm
    rank_anywhere: int  # the same, of as many poses all over the arm's range
    noise: tuple[float, float]  # standard deviation of the measurements [m, rad], as given or estimated
    before: (
        np.ndarray
    )  # (N,) distance of each measurement from the drawn arm [m], its base (if unknown) put where it fits best
    after: np.ndarray  # (N,) the same from the corrected arm
    turned: np.ndarray  # (2, N) angles [rad] before and after, of measured poses; else empty
    held_out: (
        float | None
    )  # root mean square distance [m] of measurements that took no part in the fit, each fifth in turn
    outliers: tuple[int, ...]  # rows of measurements that were left out
    reversed: dict[
        str, tuple[float, float]
    ]  # joints that count against the drawing; errors [m] without and with their reversal
    width: float  # standard deviations that the half of a 95 % interval takes
    observability: float  # index O1 of Borm and Menq (1989) of the free unknowns, in units of prior and noise
    condition: float  # ratio of the largest to the least singular value of the free unknowns
    touched: np.ndarray  # (K, 3) places found of sockets or fixed ends [m], base frame
    prior: tuple[float, float]  # prior spread [m, rad]
    T_world_base: np.ndarray  # (4, 4) the base in the frame of the measurements
    notes: tuple[str, ...]  # sentences on what the data leave open
    converged: bool  # whether the last fit ended by its tolerances
    _every: np.ndarray  # (P, P) covariance of all unknowns, as if none were fixed
    _sign: np.ndarray  # (n,) factors 1 or -1 of the joint values
    _q: np.ndarray  # (N, n) where was measured

    @classmethod
    def of(
        cls,
        fit: Fit,
        before: np.ndarray,
        fixed: Sequence[Convention],
        ranks: Sequence[int],
        prior: Any,
        against: Mapping[str, Any],
    ) -> "Calibration":
        """Make the result of a finished fit; before: errors (N, per) as drawn."""
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
            _every=fit.spread(every=True),
            _sign=arm.sign.copy(),
            _q=fit.Q.copy(),
        )
        made.notes = tuple(made._findings(data.places is not None, len(data.pairs), fit.given))
        return made

    def _findings(self, placed: bool, pairs: int, given: bool) -> list[str]:
        """Sentences on what the data leave open and what is unusual."""
        said, kept = [], len(self.after) - len(self.outliers)
        for joint, share in self.reversed.items():
            said.append(
                f"joint {joint} counts against the drawing: reversed, errors fall to {100 * share:.2g} %; the corrected robot has its axis "
                "reversed"
            )
        if self.outliers:
            rows = ", ".join(map(str, self.outliers[:12])) + (
                f" and {len(self.outliers) - 12} more" if len(self.outliers) > 12 else ""
            )
            far = length(float(self.after[list(self.outliers)].max()))
            said.append(f"left out as outliers (rows from 0): {rows}; off by up to {far}")
        if not placed:
            words = TOUCH[self.what]
            if self.what == "socket" and pairs:
                words = "the base frame is free: compare with other places only after aligning it"
            said += [words] if words else []
        elif self.what == "socket" and len(self.touched) < 3:
            said.append("two known places leave the turn about their line free: a third fixes it")
        if self.rank_anywhere > self.rank:
            said.append(f"other poses could tell {self.rank_anywhere - self.rank} more of the errors: see suggest()")
        unsure = self.unsure
        if unsure:
            some = ", ".join(unsure[:6]) + (f" and {len(unsure) - 6} more" if len(unsure) > 6 else "")
            said.append(f"hardly told by these data, so mostly assumed as drawn: {some}")
        scales = self._arm().scales(*self.prior)
        far = [
            one.name
            for one, x, s in zip(self.unknowns, self.x, scales, strict=True)
            if abs(x) > 3.0 * s and one.group != "base"
        ]
        if far:
            said.append(f"larger than assumed, so give prior= larger and look at the data: {', '.join(far[:6])}")
        count = kept * WHAT[self.what]
        if count < FEW * self.rank:
            said.append(f"only {count} numbers for {self.rank} errors: outliers and intervals are uncertain; measure more")
        rough = self.rms[1] > (5.0 * self.noise[0] if given else ROUGH)
        if rough:
            more = "add 'frames' to parameters" if "frames" not in self.parameters else "look for wrong units, rows or tips, or play in joints"
            said.append(f"what is left, {length(self.rms[1])}, is more than noise: {more}")
        return (
            said
            if self.converged
            else [*said, "the fit stopped before it had converged; take the errors as a rough answer"]
        )

    # ---------------------------------------------------------------------------------------------------- what it says
    @property
    def names(self) -> tuple[str, ...]:
        """Names of the errors that the data tell."""
        fixed = {one.fixed for one in self.fixed}
        return tuple(one.name for one in self.unknowns if one.name not in fixed)

    @property
    def unsure(self) -> tuple[str, ...]:
        """Names of errors whose interval is about as wide as was assumed before."""
        loose = np.sqrt(np.diag(self.spread)) > UNSURE * self._arm().scales(*self.prior)
        return tuple(one.name for one, is_loose in zip(self.unknowns, loose, strict=True) if is_loose)

    @property
    def errors(self) -> dict[str, tuple[float, float]]:
        """Each error [m or rad] by name, with the half width of its 95 % interval, but for those fixed."""
        half = self.width * np.sqrt(np.diag(self.spread))
        every = {one.name: (float(x), float(h)) for one, x, h in zip(self.unknowns, self.x, half, strict=True)}
        return {name: every[name] for name in self.names}

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean square distance [m] of the measurements, outliers left out, from the arm as drawn and as corrected."""
        kept = np.setdiff1d(np.arange(len(self.after)), self.outliers)
        return float(np.sqrt((self.before[kept] ** 2).mean())), float(np.sqrt((self.after[kept] ** 2).mean()))

    def _arm(self) -> DrawnArm:
        arm = DrawnArm(self.drawn, self.parameters)
        arm.sign = self._sign
        return arm

    def fk(self, q: Any) -> pin.SE3:
        """Compute the pose of the tip [m] at q (n,) [rad or m] (as it was measured) in the frame of the measurements."""
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
        return T[:, :3, 3], self.width * np.sqrt(np.maximum(np.einsum("nij,jk,nik->ni", moved, self._every, moved), 0.0))

    # ------------------------------------------------------------------------------------------------ corrected robot
    @property
    def robot(self) -> Robot:
        """The corrected robot: as drawn, with the errors written into its description. Its base is its own (see T_world_base).

        Raises ModelError if the robot has no URDF.
        """
        arm = self._arm()
        C = arm.corrections(self.x)
        model = self.drawn.model
        joints = {model.names[j]: T.homogeneous for j, T in C.items() if j > 0}
        tool = C.get(0, pin.SE3.Identity()).homogeneous
        against = [model.names[j] for j, i in self.drawn._path.owner.items() if self._sign[i] < 0.0]
        return corrected_robot(self.drawn, joints, against, tool)

    def write(self, path: str | Path) -> Robot:
        """Write the corrected robot as one plain URDF; return it, whose tip is the tip to load the file with."""
        made = self.robot
        made.write(path)
        return made

    def suggest(self, count: int, *, avoid_collisions: Any = True, seed: int = 0) -> np.ndarray:
        """Choose configurations (count, n) [rad or m] whose measurement would tell most in addition, as `suggest_poses` does."""
        known = np.linalg.inv(self._every + np.diag(1e-18 * np.ones(len(self.x))))
        return chosen_poses(
            self._arm(), self.x, known, count, self.what, self.noise, self.prior, avoid_collisions, seed
        )

    # ----------------------------------------------------------------------------------------------------------- text
    def table(self) -> TextTable:
        """Return the errors as a table, those that the data tell."""
        kinds = {one.name: one.turns for one in self.unknowns}
        rows = [
            (
                name,
                f"{shown(x, kinds[name])} +- {shown(half, kinds[name]).lstrip('+')} {'deg' if kinds[name] else 'mm'}",
            )
            for name, (x, half) in self.errors.items()
        ]
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

    def __repr__(self) -> str:
        """Return the table for terminals."""
        return str(self.table())

    def _repr_html_(self) -> str:
        """Return the table for notebooks."""
        return self.table().html()

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, strings and lists."""
        before, after = self.rms
        return {
            "robot": self.drawn.name,
            "what": self.what,
            "errors": {name: {"value": x, "half_width_95": half} for name, (x, half) in self.errors.items()},
            "fixed": {one.fixed: list(one.shared) for one in self.fixed},
            "rank": self.rank,
            "rank_drawn": self.rank_drawn,
            "rank_anywhere": self.rank_anywhere,
            "unsure": list(self.unsure),
            "rms_before": before,
            "rms_after": after,
            "held_out": self.held_out,
            "noise": list(self.noise),
            "outliers": list(self.outliers),
            "reversed": sorted(self.reversed),
            "observability": self.observability,
            "condition": self.condition,
            "T_world_base": self.T_world_base.tolist(),
            "touched": self.touched.tolist(),
            "converged": self.converged,
            "notes": list(self.notes),
        }

    def save(self, path: str | Path) -> Path:
        """Write all of it as one HTML page that needs no network: residuals before and after, errors, what the data leave open."""
        file = as_path(path, "path")
        write_whole(file, _page(self))
        return file


def shown(value: float, turns: bool) -> str:
    """Write an error [m or rad] in mm or degrees, with its sign."""
    return f"{np.degrees(value) if turns else 1e3 * value:+.3f}"


def _page(found: Calibration) -> str:
    """Write a calibration as an HTML page."""
    before, after = found.rms
    kept = len(found.after) - len(found.outliers)
    figures = {
        "measurements": f"{len(found.after)} ({found.what}), {kept} used",
        "as drawn, corrected": f"{length(before)}, {length(after)} (root mean square)",
        "held out": length(found.held_out) if found.held_out is not None else "too few measurements",
        "noise of a measurement": length(found.noise[0]) + (f", {np.degrees(found.noise[1]):.2g} deg" if found.what == "pose" else ""),
        "told": f"{found.rank} of {len(found.x)} unknowns ({found.rank_drawn} at the arm as drawn, {found.rank_anywhere} from poses all over)",
        "observability O1, condition": f"{figure(found.observability)}, {figure(found.condition)}",
    }
    parts = [
        TextTable(f"Is {found.drawn.name} as drawn?", "", ("", ""), figures.items()),
        TextTable("Errors", "in the axes of each joint's own frame", ("error", "with 95 % interval"), found.table().rows, most=1000),
    ]
    if found.fixed:
        rows = [(one.fixed, ", ".join(one.shared) or "no error: nothing measured depends on it") for one in found.fixed]
        parts.append(TextTable("Fixed as drawn", "the measurements cannot tell it from", ("fixed", "shares its motion with"), rows, most=1000))
    if len(found.touched):
        rows = [(k, *(f"{1e3 * x:.2f} mm" for x in place)) for k, place in enumerate(found.touched.tolist())]
        parts.append(TextTable("Places touched", "as found, base frame", ("", "x", "y", "z"), rows, most=1000))
    said = "".join(f"<li>{html.escape(note)}</li>" for note in found.notes)
    body = "".join(f"<section>{part.html()}</section>" for part in parts)
    title = html.escape(f"Calibration of {found.drawn.name}")
    return (
        f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>{title}</title><style>"
        "body{font:15px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}section{margin:1.5rem 0;overflow-x:auto}"
        "td,th{padding:.1rem .8rem .1rem 0;text-align:left;vertical-align:top}svg{max-width:100%;height:auto}</style></head><body>"
        f"{_picture(found)}<ul>{said}</ul>{body}</body></html>\n"
    )


def _picture(found: Calibration) -> str:
    """Draw the residual of every measurement before and after, on a logarithmic scale, as SVG."""
    wide, high, left = 800.0, 260.0, 70.0
    values = np.maximum(np.array([found.before, found.after]), 1e-9)
    low, top = np.floor(np.log10(values.min())), np.ceil(np.log10(values.max()) + 1e-9)
    y = high - 30.0 - (np.log10(values) - low) / (top - low) * (high - 50.0)
    x = left + 10.0 + (wide - left - 20.0) * (np.arange(len(found.after)) + 0.5) / len(found.after)
    rows = [f"<svg viewBox='0 0 {wide:.0f} {high:.0f}' role='img' font-family='system-ui' font-size='13'>"]
    for power in range(int(low), int(top) + 1):
        at = high - 30.0 - (power - low) / (top - low) * (high - 50.0)
        rows.append(f"<path d='M{left} {at:.1f}H{wide}' stroke='{PALE}'/><text x='{left - 6}' y='{at + 4:.1f}' text-anchor='end'>{length(10.0**power)}</text>")
    for k in range(len(x)):
        colour = COLOURS[1] if k in found.outliers else COLOURS[0]
        rows.append(f"<path d='M{x[k]:.1f} {y[0, k]:.1f}V{y[1, k]:.1f}' stroke='{PALE}'/><circle cx='{x[k]:.1f}' cy='{y[0, k]:.1f}' r='3' fill='{GREY}'/>")
        rows.append(f"<circle cx='{x[k]:.1f}' cy='{y[1, k]:.1f}' r='3.5' fill='{colour}'><title>row {k}: {length(float(found.after[k]))}</title></circle>")
    words = [(GREY, "as drawn"), (COLOURS[0], "corrected"), *([(COLOURS[1], "outlier, left out")] if found.outliers else [])]
    rows += [f"<text x='{left + 10 + 130 * k}' y='{high - 6}' fill='{colour}'>&#9679; {word}</text>" for k, (colour, word) in enumerate(words)]
    return "".join([*rows, "</svg>"])
