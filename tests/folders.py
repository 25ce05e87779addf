"""Folders and data that tests read, so that tests can be moved without adjusting relative paths."""

import json
from pathlib import Path

TESTS = Path(__file__).resolve().parent
DATA = TESTS / "data"
ROOT = TESTS.parent
SCRIPTS = ROOT / "scripts"


def read_data(name):
    """Return what tests/data/NAME.json holds: numbers of independent programs."""
    return json.loads((DATA / f"{name}.json").read_text())
