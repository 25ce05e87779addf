"""`ik reproduce`: reproduces the papers behind the toolkit, and compares published numbers with computed ones."""

import importlib.util
import os
import pkgutil
from pathlib import Path

from ..errors import InvalidOption, near_match
from .command import argument, command, option, options, require_extra
from .options import JsonOutput
from .output import notice, progress, show, table, write_json
from .streams import uninterrupted


@options()
class ReproduceOptions(JsonOutput):
    """Options for the paper and the folder of its report."""

    paper: str | None = argument("[PAPER]", "Name of a paper; omit to list them.", default=None)
    output: Path | None = option(
        "DIR", "Folder of the report; default: ./reproduce-PAPER.", "-o", "--output", needs=["PAPER"]
    )


@command
def reproduce(asked: ReproduceOptions) -> None:
    """Recompute a paper: a report with tables and pictures, with every published number next to ours.

    Writes report.md, report.json and the pictures (PNG, with matplotlib). Only the published numbers are typed in; all others are
    computed in this run. Ctrl-C keeps the report so far as report.md.partial and report.json.partial.

    Examples:
    ik reproduce
    ik reproduce chinyai -o report
    """
    from ..papers import PAPERS

    paper = asked.paper
    if paper is None:
        write_json({"papers": {name: row.summary for name, row in PAPERS.items()}}, asked.as_json)
        if not asked.as_json:
            show(table("<name", "paper", rows=[(name, row.summary) for name, row in PAPERS.items()]))
        return
    if paper not in PAPERS:
        raise InvalidOption(f"there is no paper '{paper}'.{near_match(paper, PAPERS)}")
    if (needs := PAPERS[paper].needs) is not None:
        require_extra(*needs)
    folder = asked.output or Path(f"reproduce-{paper}")
    if folder.exists() and not folder.is_dir():
        raise InvalidOption(f"-o takes a folder, and {folder} is a file")
    # The folder is made before the work, so that one that cannot be made is refused at once.
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        raise InvalidOption(f"cannot write to '{folder}': no permission")
    notice(f"computing the report of '{paper}': takes a minute or two ...")
    from ..papers.report import ReportInterrupted

    try:
        with progress("computing", None):  # There is no total (None), because a report does not tell its progress.
            report = pkgutil.resolve_name(PAPERS[paper].target)()
    except ReportInterrupted as stop:
        with uninterrupted():
            files = stop.result.write_partial(folder)
            notice(f"partial: the report so far is in {' and '.join(map(str, files))}")
        raise
    files = report.write(folder)
    write_json({**report.data, "files": [str(file) for file in files]}, asked.as_json)
    if not asked.as_json:
        show({"report": report.title, "written": ", ".join(file.name for file in files), "folder": str(folder)})
    if importlib.util.find_spec("matplotlib") is None:
        notice("no pictures: they need matplotlib (pip install matplotlib)")
