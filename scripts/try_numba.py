"""Try the installed numba: one answer, a batch and a tracker on a robot, compiled from nothing. Prints how long each took.

CI runs this with the lowest release that may be installed. Before another is named in TRIED of kernel/jit.py it
has to be added there and pass here.
"""

import os
import sys
import tempfile
import time

os.environ.setdefault("NUMBA_CACHE_DIR", tempfile.mkdtemp(prefix="try-numba-"))

import numba
import numpy as np

import ik_toolkit as ik
from ik_toolkit.kernel import jit


def main() -> int:
    robot, began, said = ik.Robot.load("hydrolek_7w"), time.perf_counter(), []

    def lap(what):
        nonlocal began
        now = time.perf_counter()
        said.append(f"{what} {now - began:.0f} s")
        began = now

    T = robot.fk(0.5 * robot.home + 0.5 * robot.random_q(np.random.default_rng(0)))
    one = ik.solve(robot, T)
    assert one.success and np.linalg.norm(robot.fk(one.q).translation - T.translation) < 1e-6, one
    lap("solve")
    if "--no-batch" not in sys.argv:
        many = ik.solve_batch(robot, np.tile(T.homogeneous, (32, 1, 1)), "lm")
        assert many.success.all(), many.counts()
        lap("batch")
    tracker = ik.Tracker(robot, q0=one.q)
    for k in range(20):
        step = tracker.update(T.translation + np.array((0.0, 0.0, 1e-4 * k)), 0.01)
    off = np.linalg.norm(robot.fk(step.q).translation - T.translation - (0.0, 0.0, 1.9e-3))
    assert off < 1e-4 and step.status.name == "OK", step
    lap("tracker")
    way = "with its own interfaces" if jit.OWN_WAY else "in its usual way"
    print(f"numba {numba.__version__} {way}: {', '.join(said)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
