"""The folder `uncompiled`: parts of the kernel that only compiled code can call, tested as plain Python."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import config

FOLDER = Path(__file__).parent / "uncompiled"


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="pytest finds the folder itself")
def test_parts_of_the_kernel():
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", str(FOLDER)]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    run = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=FOLDER.parents[2])
    assert run.returncode == 0, run.stdout + run.stderr
