"""Before an obstacle: steps of any length, and what is refused."""

import numpy as np
import pytest
from robots import load

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption


@pytest.mark.parametrize("method", ["cv", "av", "ca", "aad"])
def test_a_tracker_brakes_within_its_limits_in_steps_of_any_length(method):
    robot = load("planar_2r")
    way = [robot.fk(q).translation for q in np.linspace((0.2, 0.4), (1.2, 0.9), 91)]
    model, top = ik.CollisionModel(robot).add_sphere(0.3, way[90], name="ball"), 4.0
    tracker = ik.Tracker(robot, method, q0=(0.2, 0.4), acceleration_limits=top, avoid_collisions=model, dt_max=0.05)
    rng, rate, t, braked = np.random.default_rng(3), np.zeros(2), 0.0, 0
    for dt in 10.0 ** rng.uniform(-5.0, np.log10(0.05), 400):
        t += dt
        step = tracker.update(way[min(int(t / 0.006), 90)], dt)
        assert (np.abs(step.rate - rate) <= 1.001 * top * dt).all() and not model.collides(step.q)
        rate, braked = step.rate, braked + (step.between is not None)
    assert braked


def test_what_may_be_asked_of_a_tracker():
    robot, q = load("planar_2r"), np.array([0.0, 0.5])
    model = ik.CollisionModel(robot)
    for asked, message in (("yes", "avoid_collisions"), (ik.CollisionModel(load("hydrolek_7w")), "another Robot")):
        with pytest.raises(InvalidOption, match=message):
            ik.Tracker(robot, q0=q, avoid_collisions=asked)
    model.add_sphere(0.2, robot.fk(q), "knot")
    with pytest.raises(InvalidConfiguration, match="at q0 'link_2' touches 'knot'; start where nothing touches"):
        ik.Tracker(robot, q0=q, avoid_collisions=model)
    ik.Tracker(robot, q0=-q, avoid_collisions=True)
