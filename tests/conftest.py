"""Shared test settings: generated cases are the same in every run, and no test depends on its run time."""

import os

import pytest
from hypothesis import settings

os.environ.setdefault("IK_TOOLKIT_WAIT", "1")  # `ik` compiles and waits: no test depends on what is on disk

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# Tests that need the same large kernels run in one process: two at once would compile them twice. Others go by file.
TOGETHER = {
    "tests/tracking/": "tracker",
    "tests/papers/test_patko_2019.py": "tracker",
    "tests/paths/": "paths",
    "tests/cli/test_path.py": "paths",
}


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out the largest groups first, so that at the end no process waits long for the other."""
    from xdist.scheduler import LoadScopeScheduling

    class ByKernel(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return next((group for start, group in TOGETHER.items() if file.startswith(start)), file)

    return ByKernel(config, log)
