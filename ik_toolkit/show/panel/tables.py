"""Writes texts and tables of the panel as HTML; all contents are escaped."""

import html
from typing import Any

import numpy as np

from ...style import MUTED
from .session import KINDS, Session


def as_sentence(text: str) -> str:
    """Return a text with a capital letter and a full stop."""
    return f"{text[0].upper()}{text[1:].rstrip('.')}." if text else ""


def note_html(text: str) -> str:
    """Write a sentence in small print, or nothing if it is empty."""
    return f'<p style="padding:2px 12px;margin:0;font-size:12px">{html.escape(as_sentence(text))}</p>' if text else ""


def table_html(rows: Any, head: Any = None) -> str:
    """Write rows of texts as an HTML table."""
    cell, muted = "padding:1px 12px 1px 0;font-variant-numeric:tabular-nums;white-space:nowrap", f"color:{MUTED}"
    top = "".join(f'<th style="{cell};text-align:left;font-weight:600">{html.escape(x)}</th>' for x in head or ())
    body = "".join(
        "<tr>"
        + "".join(f'<td style="{cell}{";" + muted if not k else ""}">{html.escape(x)}</td>' for k, x in enumerate(row))
        + "</tr>"
        for row in rows
    )
    return f'<div style="padding:2px 12px 6px;font-size:12px;overflow-x:auto"><table><tr>{top}</tr>{body}</table></div>'


def pose_html(T: np.ndarray, s: Session, tip: str) -> str:
    """Write the pose of a tip as matrix, xyz, rpy and quaternion."""
    matrix = [[f"{x + 0.0:.5f}" for x in row] for row in np.round(T, 5)]
    lines = [
        ("xyz [m]", s.words(T, "free")[0]),
        (f"rpy [{'deg' if s.degrees else 'rad'}]", s.words(T, KINDS[0])[1]),
        ("quaternion xyzw", s.words(T, "quaternion")[1]),
    ]
    name = html.escape(tip) if len(s.robot.tips) > 1 else "the tip"
    head = f'<div style="padding:6px 12px 0;font-size:12px;font-weight:600">Pose of {name}, T_base_tip</div>'
    return head + table_html(matrix).replace(f"color:{MUTED}", "") + table_html(lines)
