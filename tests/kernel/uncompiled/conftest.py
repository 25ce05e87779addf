"""Tests of parts of the kernel, which only plain Python can call: `test_parts_of_the_kernel` runs this folder uncompiled."""

import pytest
from numba import config

from ik_toolkit.kernel import linalg

if not config.DISABLE_JIT:
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture
def turns(monkeypatch):
    """Rotations of two columns or rows, as they are made."""
    made, once = [], linalg.jacobi
    monkeypatch.setattr(linalg, "jacobi", lambda *numbers: made.append(numbers) or once(*numbers))
    return made
