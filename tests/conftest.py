"""Settings all tests share: generated cases are the same in every run, and no test is judged by its time."""

import os

from hypothesis import settings

os.environ.setdefault("IK_TOOLKIT_WAIT", "1")  # `ik` compiles and waits: no test depends on what is on disk

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
