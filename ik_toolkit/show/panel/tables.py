"""Writes texts, tables and files of the panel as HTML; all contents are escaped."""

import base64
import html
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InvalidOption
from ...paths.timing import through
from ...style import MUTED
from ...text import how_many
from .session import KINDS, Session


def as_sentence(text: str) -> str:
    """Return a text beginning with a capital letter and ending with a full stop."""
    return f"{text[0].upper()}{text[1:].rstrip('.')}." if text else ""


def note_html(text: str, color: str = "inherit") -> str:
    """Return HTML of a sentence in small print, or '' if the sentence is empty."""
    style = f"padding:2px 12px;margin:0;font-size:12px;color:{color}"
    return f'<p style="{style}">{html.escape(as_sentence(text))}</p>' if text else ""


def table_html(rows: Any, head: Any = None) -> str:
    """Return an HTML table of rows of texts."""
    cell, muted = "padding:1px 12px 1px 0;font-variant-numeric:tabular-nums;white-space:nowrap", f"color:{MUTED}"
    top = "".join(f'<th style="{cell};text-align:left;font-weight:600">{html.escape(x)}</th>' for x in head or ())
    body = table_rows(rows, cell, muted)
    return f'<div style="padding:2px 12px 6px;font-size:12px;overflow-x:auto"><table><tr>{top}</tr>{body}</table></div>'


def table_rows(rows: Any, cell: str, lead: str) -> str:
    """Return rows of texts as rows of an HTML table; cell: CSS of all cells, lead: more CSS for the first column."""
    cells = (
        [f'<td style="{cell}{"" if k else f";{lead}"}">{html.escape(x)}</td>' for k, x in enumerate(row)]
        for row in rows
    )
    return "".join(f"<tr>{''.join(row)}</tr>" for row in cells)


class Recorder:
    """Controls that record configurations and save the motion through them."""

    def __init__(self, desk: Any) -> None:
        """Build the controls on a visitor's page."""
        self.desk, self.session, self.say = desk, desk.session, desk.say
        with desk.gui.add_folder("Motion", expand_by_default=False):
            desk._button("Record this posture", "record", self.record)
            desk._button("Save the motion", "record", self.save)
            desk._button("Forget the record", "record", self.forget)
            hint = "Of every joint [rad/s2 or m/s2]; speeds are the robot's limits, or 1."
            self.acceleration = desk.gui.add_number("Acceleration", 1.0, min=1e-3, hint=hint)

    def record(self) -> None:
        """Add the present configuration to the motion."""
        self.session.recorded.append(self.session.q.copy())
        count = len(self.session.recorded)
        self.say(f"{how_many(count, 'posture')} recorded")

    def forget(self) -> None:
        """Remove all recorded configurations, to begin a new motion."""
        self.session.recorded.clear()
        self.say("the record is empty")

    def files(self) -> tuple[str, dict[str, bytes]]:
        """Return a sentence on the recorded motion, and the contents of its files by name: CSV, and JSON with a ROS trajectory.

        Raises InvalidOption.
        """
        s = self.session
        if len(s.recorded) < 2:
            raise InvalidOption("record two postures or more, then save the motion through them")
        speeds = np.where(np.isfinite(s.robot.velocity_limits), s.robot.velocity_limits, 1.0)
        around = s.world if s.avoid else None
        found = through(s.robot, s.recorded, speeds, float(self.acceleration.value), collision=around)
        with tempfile.TemporaryDirectory() as folder:
            written = [found.to_csv(Path(folder) / "motion.csv"), found.to_json(Path(folder) / "motion.json")]
            return found.message, {file.name: file.read_bytes() for file in written}

    def save(self) -> None:
        """Offer the recorded motion on the page as links to its files."""
        message, files = self.files()
        kinds = {".csv": ("text/csv", "CSV"), ".json": ("application/json", "JSON of a ROS JointTrajectory")}
        links = []
        for name, content in files.items():
            kind, words = kinds[Path(name).suffix]
            data = base64.b64encode(content).decode()
            links.append(f'<p><a download="{name}" href="data:{kind};base64,{data}">{name}</a>: {words}</p>')
        content = note_html(message) + f'<div style="padding:4px 12px">{"".join(links)}</div>'
        self.desk._dialog("Motion (metres, radians and seconds)", content)
        self.say(message)


def pose_html(T: np.ndarray, s: Session, tip: str) -> str:
    """Return HTML with the pose of a tip as matrix, xyz, rpy and quaternion."""
    matrix = [[f"{x + 0.0:.5f}" for x in row] for row in np.round(T, 5)]
    lines = [
        ("xyz [m]", s.words(T, "free")[0]),
        (f"rpy [{'deg' if s.degrees else 'rad'}]", s.words(T, KINDS[0])[1]),
        ("quaternion xyzw", s.words(T, "quaternion")[1]),
    ]
    name = html.escape(tip) if len(s.robot.tips) > 1 else "the tip"
    head = f'<div style="padding:6px 12px 0;font-size:12px;font-weight:600">Pose of {name}, T_base_tip</div>'
    return head + table_html(matrix).replace(f"color:{MUTED}", "") + table_html(lines)
