"""A run that is lost says so, whatever counts of its poses: the explanation tries the position alone."""

import pytest
import robots
from references import line_of

import ik_toolkit as ik


@pytest.mark.parametrize(
    "options",
    [
        {"mask": (1, 1, 1, 1, 1, 0.5)},
        {"mask": (1, 1, 1, 0.5, 0.5, 0.0)},
        {"mask": (0, 0, 0, 1, 1, 1)},
        {"slack": (0, 0, 0, 0, 0, 0.1)},
        {"free_turn": (0, 0, 1)},
        {"mask": (1, 1, 1, 1, 1, 0), "frame": "tip"},
    ],
)
def test_a_lost_run_never_raises(options):
    robot = robots.load("hydrolek_7w")
    line = line_of(robot, robot.home, (0.0, 1.5, 0.0), 1.0, "constant")
    run = ik.track(robot, line, q0=robot.home, **options)
    assert run.message
    if options != {"mask": (0, 0, 0, 1, 1, 1)}:
        assert run.status.name == "LOST", run
