"""Report of a calibration: sentences on what the data do not determine, and an HTML page."""

import html
from typing import Any

import numpy as np

from ..style import COLOURS, GREY, PALE
from ..text import TextTable, figure, first_few, length
from .measurements import WHAT

ROUGH = 0.005  # [m] If the errors left after calibration are larger, they are not just noise of the instrument.
FEW = 2.2  # With fewer measured numbers per unknown, outliers cannot be detected well.
TOUCH = {
    "pose": "",
    "position": "the direction in which the tool points is not measured",
    "distance": "the base frame is free: distances from places that are not known fix no directions",
    "socket": "the base frame and the scale are free: all lengths may be longer by one factor; measure a distance of two sockets",
    "plane": "the base frame and the scale are free, because the planes are not known",
}


def open_points(found: Any, placed: bool, pairs: int, given: bool) -> list[str]:
    """Return sentences on what the data do not determine and on what is unusual.

    placed: whether positions of touched sockets are known. pairs: number of known distances between sockets. given: whether the
    caller gave the noise.
    """
    said, kept = [], len(found.after) - len(found.outliers)
    for joint, share in found.reversed.items():
        said.append(
            f"joint {joint} counts against the drawing: reversed, errors fall to {100 * share:.2g} %; the corrected robot has its "
            "axis reversed"
        )
    if found.outliers:
        rows = first_few([*map(str, found.outliers)], 12)
        far = length(float(found.after[list(found.outliers)].max()))
        said.append(f"left out as outliers (rows from 0): {rows}; off by up to {far}")
    if not placed:
        words = TOUCH[found.what]
        if found.what == "socket" and pairs:
            words = "the base frame is free: compare with other places only after aligning it"
        said += [words] if words else []
    elif found.what == "socket" and len(found.touched) < 3:
        said.append("two known places leave the turn about their line free: a third fixes it")
    if found.rank_anywhere > found.rank:
        said.append(f"other poses could tell {found.rank_anywhere - found.rank} more of the errors: see suggest()")
    unsure = found.unsure
    if unsure:
        said.append(f"hardly told by these data, so mostly assumed as drawn: {first_few(unsure, 6)}")
    if found.implausible:
        remedy = "look at units, labels and rows of the data, or give a larger prior="
        said.append(f"larger than assumed ({remedy}): {', '.join(found.implausible[:6])}")
    different = len(np.unique(found.q, axis=0))
    if found.what in ("pose", "position") and different < len(found.q):
        said.append(
            f"only {different} of the {len(found.q)} configurations differ: one measured again averages noise alone, and a copied "
            "row makes the intervals too narrow"
        )
    count = kept * WHAT[found.what]
    if count < FEW * found.rank:
        said.append(f"only {count} numbers for {found.rank} errors: outliers and intervals are uncertain; measure more")
    if found.rms[1] > (5.0 * found.noise[0] if given else ROUGH):
        more = "look for wrong units, rows, columns of joints or tips, or play in joints"
        more = more if "frames" in found.parameters else "add 'frames' to parameters"
        said.append(f"what is left, {length(found.rms[1])}, is more than noise: {more}")
    if not found.converged:
        said.append("the fit stopped before it had converged; take the errors as a rough answer")
    return said


def page(found: Any) -> str:
    """Return a Calibration as the text of an HTML page: errors, residuals, and what the data do not determine."""
    before, after = found.rms
    kept = len(found.after) - len(found.outliers)
    figures = {
        "measurements": f"{len(found.after)} ({found.what}), {kept} used",
        "as drawn, corrected": f"{length(before)}, {length(after)} (root mean square)",
        "held out": length(found.held_out) if found.held_out is not None else "too few measurements",
        "noise of a measurement": length(found.noise[0])
        + (f", {np.degrees(found.noise[1]):.2g} deg" if found.what == "pose" else ""),
        "told": f"{found.rank} of {len(found.x)} unknowns ({found.rank_drawn} at the arm as drawn, {found.rank_anywhere} from poses"
        " all over)",
        "observability O1, condition": f"{figure(found.observability)}, {figure(found.condition)}",
    }
    axes, head = "in the axes of each joint's own frame", ("error", "with 95 % interval")
    parts = [
        TextTable(f"Is {found.drawn.name} as drawn?", "", ("", ""), figures.items()),
        TextTable("Errors", axes, head, found.table().rows, most=1000),
    ]
    if found.fixed:
        rows = [(one.fixed, ", ".join(one.shared) or "no error: nothing measured depends on it") for one in found.fixed]
        words, head = "the measurements cannot tell it from", ("fixed", "shares its motion with")
        parts.append(TextTable("Fixed as drawn", words, head, rows, most=1000))
    if len(found.touched):
        rows = [(k, *(f"{1e3 * x:.2f} mm" for x in place)) for k, place in enumerate(found.touched.tolist())]
        parts.append(TextTable("Places touched", "as found, base frame", ("", "x", "y", "z"), rows, most=1000))
    table = found.dh
    if table is not None:
        head = ("joint", "theta (deg)", "d (mm)", "a (mm)", "alpha (deg)")
        scale = np.array([180.0 / np.pi, 1e3, 1e3, 180.0 / np.pi])
        rows = [
            (row.name, *(f"{x + 0.0:.3f}" for x in np.round(scale * (row.theta, row.d, row.a, row.alpha), 3)))
            for row in table.rows
        ]
        words = "corrected arm, classic convention; lengths are large where two axes are nearly parallel"
        parts.append(TextTable("Denavit-Hartenberg table", words, head, rows, most=1000))
    said = "".join(f"<li>{html.escape(note)}</li>" for note in found.notes)
    body = "".join(f"<section>{part.html()}</section>" for part in parts)
    title = html.escape(f"Calibration of {found.drawn.name}")
    return (
        f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>{title}</title><style>"
        "body{font:15px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
        "section{margin:1.5rem 0;overflow-x:auto}"
        "td,th{padding:.1rem .8rem .1rem 0;text-align:left;vertical-align:top}svg{max-width:100%;height:auto}</style></head><body>"
        f"{_picture(found)}<ul>{said}</ul>{body}</body></html>\n"
    )


def _picture(found: Any) -> str:
    """Draw the residual of every measurement before and after, on a logarithmic scale, as SVG."""
    wide, high, left = 800.0, 260.0, 70.0
    values = np.maximum(np.array([found.before, found.after]), 1e-9)
    low, top = np.floor(np.log10(values.min())), np.ceil(np.log10(values.max()) + 1e-9)
    y = high - 30.0 - (np.log10(values) - low) / (top - low) * (high - 50.0)
    x = left + 10.0 + (wide - left - 20.0) * (np.arange(len(found.after)) + 0.5) / len(found.after)
    rows = [f"<svg viewBox='0 0 {wide:.0f} {high:.0f}' role='img' font-family='system-ui' font-size='13'>"]
    for power in range(int(low), int(top) + 1):
        at = high - 30.0 - (power - low) / (top - low) * (high - 50.0)
        rows.append(
            f"<path d='M{left} {at:.1f}H{wide}' stroke='{PALE}'/>"
            f"<text x='{left - 6}' y='{at + 4:.1f}' text-anchor='end'>{length(10.0**power)}</text>"
        )
    for k in range(len(x)):
        colour = COLOURS[1] if k in found.outliers else COLOURS[0]
        rows.append(
            f"<path d='M{x[k]:.1f} {y[0, k]:.1f}V{y[1, k]:.1f}' stroke='{PALE}'/>"
            f"<circle cx='{x[k]:.1f}' cy='{y[0, k]:.1f}' r='3' fill='{GREY}'/>"
        )
        rows.append(
            f"<circle cx='{x[k]:.1f}' cy='{y[1, k]:.1f}' r='3.5' fill='{colour}'>"
            f"<title>row {k}: {length(float(found.after[k]))}</title></circle>"
        )
    words = [(GREY, "as drawn"), (COLOURS[0], "corrected")]
    words += [(COLOURS[1], "outlier, left out")] if found.outliers else []
    rows += [
        f"<text x='{left + 10 + 130 * k}' y='{high - 6}' fill='{colour}'>&#9679; {word}</text>"
        for k, (colour, word) in enumerate(words)
    ]
    return "".join([*rows, "</svg>"])
