"""Calls that are refused, a row each: the call and words of its sentence."""

import pytest


def refuses(error, *rows):
    """Every call of the rows (call, words) raises this error, and the words match what it says."""
    for call, words in rows:
        with pytest.raises(error, match=words):
            call()
            pytest.fail(f"nothing was refused with: {words}")
