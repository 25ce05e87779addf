"""The bar on a terminal."""

import io
import sys

from ik_toolkit.cli.output import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_the_time_left_is_that_of_the_limit_not_of_the_generations(monkeypatch):
    """One of two hundred generations is done at once: an estimate would say that hardly any time is left."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress("searching", 200, 90.0) as bar:
        bar(199)
    shown = sys.stderr.getvalue()
    assert "199/200" in shown and ("0:01:30" in shown or "0:01:29" in shown)
