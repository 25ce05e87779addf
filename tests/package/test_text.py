"""Typed input: one number parser for the command line and the panel."""

import math
from pathlib import Path

import numpy as np
import pytest

from ik_toolkit.errors import InvalidOption, InvalidTarget
from ik_toolkit.text import numbers, parameter, plain, vector


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
