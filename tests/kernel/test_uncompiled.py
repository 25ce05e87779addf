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
    # To rewrite the assertions takes as long as a third of the tests: only what fails is run again for its details.
    for details in (["--assert=plain"], []):
        run = subprocess.run(
            [*command, *details], capture_output=True, text=True, env=environment, cwd=FOLDER.parents[2]
        )
        if run.returncode == 0 and details:
            return
    pytest.fail(run.stdout + run.stderr)
