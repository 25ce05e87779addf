"""Folders and data that tests read, so that tests can be moved without adjusting relative paths."""

import csv
import json
from pathlib import Path

TESTS = Path(__file__).resolve().parent
DATA = TESTS / "data"
ROOT = TESTS.parent
SCRIPTS = ROOT / "scripts"


def read_data(name):
    """Return what tests/data/NAME.json holds: numbers of independent programs."""
    return json.loads((DATA / f"{name}.json").read_text())


def csv_rows(path):
    """Rows of a CSV file as dicts of texts by column."""
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def write_csv(path, header, rows):
    """Write a CSV file of a header, as "x,y,z", and rows of values; returns its path."""
    with open(path, "w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header.split(","), *rows])
    return path
