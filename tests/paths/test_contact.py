"""Contact between poses, against much finer sampling than the proof uses."""

import numpy as np
import pinocchio as pin
import pytest

import ik_toolkit as ik
from ik_toolkit.paths.contact import Margins, find_contacts

FINE = 400  # samples of a stretch

ARM = """
<robot name="arm">
  <link name="base"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
  {joints}
</robot>
"""
JOINT = """
<link name="l{k}"><collision><origin xyz="0 0 0.15"/><geometry><cylinder radius="0.04" length="0.24"/></geometry></collision></link>
<joint name="j{k}" type="{kind}"><parent link="{parent}"/><child link="l{k}"/><origin xyz="0 0 {up}"/><axis xyz="{axis}"/>
<limit lower="-2.6" upper="2.6" effort="1" velocity="1"/>{mimic}</joint>
"""


def arm():
    """Four revolute joints, one of which follows, and a slide, with cylinders for links."""
    follows = '<mimic joint="j1" multiplier="-0.5" offset="0.2"/>'
    kinds = [("0 0 1", ""), ("0 1 0", ""), ("0 1 0", ""), ("1 0 0", follows), ("0 0 1", "")]
    joints = "".join(
        JOINT.format(
            k=k, kind="prismatic" if k == 4 else "revolute", parent=f"l{k - 1}" if k else "base", up=0.3 if k else 0.1,
            axis=axis, mimic=mimic,
        )
        for k, (axis, mimic) in enumerate(kinds)
    )  # fmt: skip
    return ik.Robot.load(ARM.format(joints=joints), tip="l4")


def scene(robot, rng, count=4):
    """Its own links, and boxes and spheres thrown around it."""
    model = ik.CollisionModel(robot)
    for _ in range(count):
        place = rng.normal(size=3)
        place *= rng.uniform(0.4, 1.1) / np.linalg.norm(place)
        if rng.random() < 0.5:
            model.add_box(rng.uniform(0.05, 0.3, 3), place)
        else:
            model.add_sphere(rng.uniform(0.03, 0.15), place)
    return model


def path(robot, rng, count=4, size=0.25):
    """Random joint path (count, n) inside the limits."""
    start = robot.random_q(rng).clip(-2.0, 2.0)
    steps = rng.uniform(-size, size, (count - 1, robot.n))
    steps[:, robot.slides] *= 0.2
    return np.clip(np.vstack([start, start + np.cumsum(steps, axis=0)]), robot.lower, robot.upper)


def touching(model, a, b):
    """Shares of the move from a to b at which something touches."""
    shares = np.linspace(0.0, 1.0, FINE)
    return shares[[model.collides(a + s * (b - a)) for s in shares]]


def test_every_contact_between_poses_is_found_and_none_is_invented():
    robot = arm()
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(12):
        model, curve = scene(robot, rng), path(robot, rng)
        at = np.arange(float(len(curve)))
        clearance, contacts, unproven = find_contacts(model, curve, at, np.ones(len(curve) - 1, dtype=bool))
        for contact in contacts:
            k = min(int(contact.place), len(curve) - 2)
            q = curve[k] + (contact.place - k) * (curve[k + 1] - curve[k])
            assert contact.pair in model.collisions(q)
        for k in range(len(curve) - 1):
            near = [contact for contact in contacts if k <= contact.place <= k + 1]
            if len(touching(model, curve[k], curve[k + 1])):
                assert near or k in unproven
        found += len(contacts)
        assert (clearance == 0.0) if contacts else clearance >= 0.0
    assert found > 5


def test_a_bead_between_two_poses_is_found():
    """Both poses and the halfway point are free of a bead of 2 mm that the arm sweeps over."""
    robot = arm()
    a, b = np.array([0.0, 1.2, 0.0, 0.0]), np.array([0.4, 1.2, 0.0, 0.0])
    inside = robot.fk(a + 0.3 * (b - a)) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15]))
    model = ik.CollisionModel(robot).add_sphere(0.001, inside.translation, name="bead")
    assert not any(model.collides(q) for q in (a, 0.5 * (a + b), b))
    _, contacts, _ = find_contacts(model, np.array([a, b]), np.arange(2.0), np.ones(1, dtype=bool))
    assert [contact.pair[1] for contact in contacts] == ["bead"]
    _, contacts, _ = find_contacts(model, np.array([a, b]), np.arange(2.0), np.zeros(1, dtype=bool))
    assert not contacts  # where the motion breaks, nothing moves from the one row to the next


@pytest.mark.parametrize("name", ["arm", "brokk_hydrolek"])
def test_no_move_brings_a_pair_nearer_than_the_bound(name):
    """Distances by coal at both ends of random moves differ by no more than the arms say."""
    rng = np.random.default_rng(1)
    robot = arm() if name == "arm" else ik.Tree.load(name)
    model = scene(robot, rng)
    margins = Margins(
        model, np.where(np.isfinite(robot.upper), np.maximum(np.abs(robot.lower), np.abs(robot.upper)), 0.0)
    )
    data, found, _ = model.workspace(np.zeros(len(model.geometry.collisionPairs)))
    for _ in range(60):
        ends = path(robot, rng, 2, 0.5)
        distances = []
        for q in ends:
            pin.computeDistances(robot.model, data, model.geometry, found, model._full(q))
            distances.append([result.min_distance for result in found.distanceResults])
        change = np.abs(np.diff(distances, axis=0)[0])
        apart = np.min(distances, axis=0) > 0.0
        assert (change[apart] <= (np.abs(ends[1] - ends[0]) @ margins.arms)[apart] + 1e-6).all()


@pytest.mark.parametrize("rows", [2, 30])
def test_the_clearance_is_kept_and_near_what_is_found(rows):
    """Also along straight moves of many degrees, whose ends say little about what lies between."""
    robot, rng = arm(), np.random.default_rng(3)
    seen = 0
    while seen < 3:
        model, ends = scene(robot, rng), path(robot, rng, 2, 0.3)
        curve = ends[0] + np.linspace(0.0, 1.0, rows)[:, None] * (ends[1] - ends[0])
        clearance, contacts, _ = find_contacts(model, curve, np.arange(float(rows)), np.ones(rows - 1, dtype=bool))
        if contacts:
            continue
        seen += 1
        fine = ends[0] + np.linspace(0.0, 1.0, 250)[:, None] * (ends[1] - ends[0])
        found = min(near.distance for q in fine for near in model.distances(q))
        assert 0.89 * found <= clearance <= found + 1e-9


def test_a_margin_that_is_kept_is_part_of_the_clearance_and_what_is_not_proven_has_none():
    """The arm turns about the upright under a plate, at the margin's distance or a little less."""
    robot = arm()
    curve = np.array([[0.0, 1.2, 0.0, 0.0], [0.1, 1.2, 0.0, 0.0]])

    def clearance(margin, height):
        model = ik.CollisionModel(robot, margin=margin).add_box((3.0, 3.0, 0.01), (0.0, 0.0, height))
        return model, find_contacts(model, curve, np.arange(2.0), np.ones(1, dtype=bool))

    free = clearance(0.0, 2.0)[0].distances(curve[0])
    gap = next(near.distance for near in free if "box" in near.pair[1])
    for above, kept in ((1e-3, True), (5e-5, False)):
        found, contacts, unproven = clearance(0.01, 2.0 - gap + 0.01 + above)[1]
        assert not contacts and (unproven == ()) == kept
        assert 0.01 <= found <= 0.01 + above if kept else found == 0.0


BOOM = """<robot name="boom"><link name="root"/><link name="arm"/><link name="slide"/>
<link name="hand"><collision><geometry><box size="0.004 0.004 0.004"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="root"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="out" type="prismatic"><parent link="arm"/><child link="slide"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.2" effort="1" velocity="1"/></joint>
<joint name="boom" type="prismatic"><parent link="slide"/><child link="hand"/><axis xyz="1 0 0"/>{mimic}
<limit lower="0" upper="3" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("held", [True, False])
def test_a_boom_held_out_or_with_an_offset_is_as_long_as_it_stands(held):
    """The two metres of a slide that is locked, or follows with an offset, swing with the turning joint past a thin pole."""
    follows = '<mimic joint="out" multiplier="1" offset="2"/>'
    robot = ik.Robot.load(
        BOOM.format(mimic="" if held else follows), tip="hand", locked={"boom": 2.0} if held else None
    )
    turned = [robot.fk((turn, 0.05)).translation for turn in np.arange(0.0, 0.08, 0.02)]
    x, far = 0.0455, np.linalg.norm(turned[0])
    pole = ik.CollisionModel(robot).add_cylinder(0.001, 1.0, (far * np.cos(x), far * np.sin(x), 0.0), name="pole")
    motion = ik.solve_path(robot, turned, avoid_collisions=pole).retime(acceleration=1.0)
    least = min(pole.distance(motion.at(t)[0]).distance for t in np.linspace(motion.t[0], motion.t[-1], 500))
    assert motion.success
    assert 0.0 < motion.clearance <= least
