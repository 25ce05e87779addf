"""Typed input: one number parser for the command line and the panel."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from sources import PACKAGE

from ik_toolkit.errors import InvalidOption, InvalidTarget
from ik_toolkit.text import angle, duration, figure, length, numbers, parameter, plain, vector


@pytest.mark.parametrize("text", ["1 -2 3e-1", "1,-2,.3", " 1, -2  0.3 "])
def test_spaces_and_commas_mean_the_same(text):
    assert numbers(text) == vector(text, "--xyz", 3) == [1.0, -2.0, 0.3]


@pytest.mark.parametrize(
    ("text", "size", "error", "says"),
    [
        ("", None, InvalidOption, "--q takes numbers, not ''"),
        ("1 up", None, InvalidOption, "--q takes numbers, not '1 up'"),
        ("1 up", 2, InvalidTarget, "--q takes 2 numbers, not '1 up'"),
        ("1 2 3", 2, InvalidTarget, "--q takes 2 numbers; got 3"),
    ],
)
def test_what_is_no_vector_is_named(text, size, error, says):
    with pytest.raises(error) as caught:
        vector(text, "--q", size)
    assert str(caught.value) == says


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("3.0", 3.0),
        ("-1e-3", -1e-3),
        ("[1, 2.5]", [1, 2.5]),
        ("True", True),
        ("false", False),
        ("mid-range", "mid-range"),
    ],
)
def test_a_parameter_is_a_number_a_list_or_a_word(text, value):
    found = parameter("gain", text)
    assert found == value and type(found) is type(value)


def test_a_parameter_that_is_none_of_these_is_named():
    with pytest.raises(InvalidOption, match=r"parameter 'gain' takes a number or a list like \[1, 2\], not '\[1,'"):
        parameter("gain", "[1,")


def test_what_a_result_holds_becomes_json():
    made = plain({"a": np.array([1.0, math.nan]), 2: (np.float64(math.inf), Path("x")), "c": {np.int64(3)}})
    assert made == {"a": [1.0, None], "2": [None, "x"], "c": [3]}


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (figure(3884.0), "3880"),
        (figure(1.25e-6), "1.25e-6"),
        (figure(2e9), "2e9"),
        (figure(0.0), "0"),
        (length(1.47e-8), "14.7 nm"),
        (length(0.9996e-3), "1 mm"),  # not 1e+03 um
        (length(9.999e-7, 3), "1 um"),
        (length(-0.02), "-20 mm"),
        (length(3.88e6), "3880000 m"),
        (length(2.2e-16), "under 0.01 nm"),  # rounding has no digits
        (length(0.0), "0 mm"),
        (duration(2.1), "2.1 s"),
        (duration(0.0005), "500 us"),
        (angle(np.radians(12.34)), "12.3 deg"),
        (angle(0.2154, deg=False), "0.215 rad"),
        (angle(2.09e-8), "20.9 nrad"),
        (angle(2.09e-8, deg=False), "20.9 nrad"),
        (angle(0.0), "0 deg"),
    ],
)
def test_sizes_are_told_as_a_person_writes_them(said, words):
    assert said == words


def test_no_size_is_told_with_the_exponent_of_a_computer():
    rng = np.random.default_rng(0)
    for value in 10.0 ** rng.uniform(-20, 4, 3000):
        for words in (length(value), duration(value), angle(value), angle(value, deg=False)):
            head, unit = words.removeprefix("under ").split()
            size = {"deg": np.pi / 180, "rad": 1, "m": 1, "s": 1, "mm": 1e-3, "ms": 1e-3}.get(unit)
            size = size or (1e-6 if unit[0] == "u" else 1e-9)
            assert "e" not in head
            assert float(head) * size == pytest.approx(value, rel=6e-3) or (
                words[0] == "u" and value < float(head) * size
            )


def test_only_one_place_writes_lengths():
    """A second form of lengths in sentences begins with a factor of a thousand and significant digits."""
    own = re.compile(r"(1e3|1000(\.0)?) \* [^{}]*:\.\dg\} mm")
    paths = [path for path in PACKAGE.rglob("*.py") if "papers" not in path.parts]
    assert [str(path) for path in paths if own.search(path.read_text("utf-8"))] == []
