"""Robots the tests share: the shipped ones, arms of example-robot-data, and small URDFs with every kind of joint."""

import functools
import importlib.metadata
import importlib.util
import itertools

import numpy as np
import pytest

import ik_toolkit as ik

PLANAR = ("planar_2r", "planar_3r", "cartesian_pp")  # cannot reach three of the six rows of a pose
SHIPPED = ("hydrolek_7w", "planar_3r", "planar_2r", "cartesian_pp", "inspection_7dof")
DATA_ARMS = (
    ("panda", "panda_hand_tcp"),
    ("ur3", "tool0"),
    ("ur5", "tool0"),
    ("ur10", "tool0"),
    ("xarm7", "link_eef"),
    ("kinova", "j2s6s200_end_effector"),
    ("z1", "gripperStator"),
    ("so100", "gripper"),
    ("so101", "gripper_frame_link"),
    ("tiago", "hand_tool_link"),
    ("baxter", "left_gripper"),
    ("pr2", "l_gripper_tool_frame"),
    ("talos", "gripper_right_base_link"),
    ("centauro", "arm1_8"),
)


def joint(name, kind, parent, child, axis="0 0 1", xyz="0 0 0.2", rpy="0 0 0", limits=(-2.0, 2.0), mimic=""):
    """Return one URDF joint and its child link."""
    limit = (
        ""
        if kind in ("fixed", "continuous")
        else f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="2"/>'
    )
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}{mimic}</joint>'
    )


def tie(leader, ratio=1, offset=0):
    """Return the <mimic> of a joint that is ratio times another plus offset; what files may leave out is left out."""
    more = (f' multiplier="{ratio}"' if ratio != 1 else "") + (f' offset="{offset}"' if offset else "")
    return f'<mimic joint="{leader}"{more}/>'


def branches(*joints, root="o", name="r"):
    """Return a URDF of joints as `joint` writes them, in any order, and of the link at their root."""
    return f'<robot name="{name}"><link name="{root}"/>{"".join(joints)}</robot>'


def urdf(*joints, name="test"):
    """Return a URDF of chained joints given as dicts for `joint` (parents and children are filled in)."""
    chained = (joint(f"j{i}", parent=f"l{i}", child=f"l{i + 1}", **keywords) for i, keywords in enumerate(joints))
    return branches(*chained, root="l0", name=name)


def filled(text, contents):
    """Return a URDF with something inside links that were empty: text by link."""
    for link, inside in contents.items():
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{inside}</link>')
    return text


def ball(radius):
    """Return a sphere as a link's shape for collisions."""
    return f'<collision><geometry><sphere radius="{radius}"/></geometry></collision>'


CONTINUOUS = urdf(
    dict(kind="continuous"),
    dict(kind="revolute", axis="0 1 0", rpy="1 2 3", xyz="0.1 0 0.2"),
    dict(kind="continuous", axis="1 1 0", rpy="0 1 0"),
    dict(kind="revolute", axis="0 0 -1", rpy=".3 0 0", xyz="0.2 0.1 0"),
    dict(kind="continuous", axis="1 0 0", rpy="0 0 1"),
    dict(kind="revolute", axis="0 1 1", rpy="2 0 0", xyz="0 0.1 0.1"),
    name="continuous_mix",
)
MIMIC = urdf(
    dict(kind="revolute"),
    dict(kind="revolute", axis="0 1 0", xyz=".1 0 .2"),
    dict(kind="revolute", axis="0 1 0", limits=(-1.0, 1.0), mimic=tie("j1", -0.6, 0.2)),
    dict(kind="revolute", axis="1 0 0", rpy="0 .3 0"),
    dict(kind="prismatic", axis="1 0 0", limits=(-0.3, 0.3), mimic=tie("j0", 0.1, 0.05)),
    dict(kind="revolute", axis="0 1 1", rpy=".7 0 0"),
    dict(kind="revolute", rpy="0 0 .4"),
    dict(kind="revolute", axis="0 1 0", rpy=".2 0 1"),
    name="mimic_mix",
)
SLIDES = urdf(
    dict(kind="prismatic", axis="1 0 0", limits=(-1.0, 1.0)),
    dict(kind="prismatic", axis="1 1 0", rpy=".2 .3 0", limits=(-0.5, 0.8)),
    dict(kind="revolute", rpy="1 0 0"),
    dict(kind="fixed", xyz=".5 .1 .2"),
    dict(kind="revolute", axis="0 1 0", rpy="0 .5 0"),
    dict(kind="prismatic", xyz=".1 .2 .3", limits=(0.0, 0.6)),
    dict(kind="revolute", axis="1 0 0", rpy="0 0 .2"),
    dict(kind="revolute", rpy=".4 1 0"),
    name="slides_mix",
)
FORK = (  # two arms of a joint each
    '<robot name="fork"><link name="a"/>'
    + joint("jb", "revolute", "a", "b", xyz="1 0 0", limits=(-1.0, 1.0))
    + joint("jc", "revolute", "a", "c", xyz="1 0 0", limits=(-1.0, 1.0))
    + "</robot>"
)
RADII = (0.05, 0.05, 0.08, 0.06, 0.05, 0.04, 0.05, 0.04, 0.05)
BALLS_MIMIC = filled(MIMIC, {f"l{k}": ball(radius) for k, radius in enumerate(RADII)})
MADE = {"continuous_mix": CONTINUOUS, "mimic_mix": MIMIC, "slides_mix": SLIDES}


def few_joints(count, seed, slides=False):
    """An arm of `count` joints at random places, with a tool beyond the last."""
    rng = np.random.default_rng(seed)
    joints = [
        dict(
            kind="prismatic" if slides and k % 2 else "revolute",
            axis=" ".join(map(str, rng.normal(size=3))),
            xyz=" ".join(map(str, rng.uniform(-0.3, 0.3, 3))),
            rpy=" ".join(map(str, rng.uniform(-3.0, 3.0, 3))),
            limits=(-2.5, 2.5),
        )
        for k in range(count)
    ]
    return ik.Robot.load(urdf(*joints, dict(kind="fixed", xyz="0.4 0 0", rpy="0.3 0.2 0.1")))


def planar_pose(x, y, angle):
    """A pose (4, 4) in the plane of x and y."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:2, 3] = x, y
    return T


def have_data():
    """Whether example-robot-data's arms are installed."""
    try:
        importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def needs(row):
    """Skip the test where a solver's package is not installed."""
    if row.name == "eaik" and importlib.util.find_spec("eaik") is None:
        pytest.skip("EAIK is not installed (extra 'analytic')")


@functools.cache
def load(name):
    """Load a robot of the tests by name, once."""
    if name in MADE:
        return ik.Robot.load(MADE[name])
    if name == "two_arms":
        return ik.Tree.load("brokk_hydrolek")
    if name in ("floating", "planar", "held"):  # one joint of the file is several of q, or none
        kind, limits = ("floating", None) if name == "held" else (name, (-1.0, 1.0))
        free = dict(kind=kind, axis="1 1 0", xyz="0.1 0 0.2", rpy="1 2 3")
        text = urdf(
            dict(kind="revolute"),
            free,
            dict(kind="revolute", axis="0 1 0", xyz=".1 0 .2"),
            dict(kind="fixed", xyz=".3 .1 0"),
        )
        return ik.Robot.load(text, base_limits=limits)
    if name == "locked":
        return ik.Robot.load("inspection_7dof", locked={"lift": 0.25})
    if name == "tool":
        return ik.Robot.load("hydrolek_7w").with_tool(ik.pose((0.05, -0.02, 0.1), rpy=(0.3, 0.2, 0.1)))
    return ik.Robot.load(name, tip=dict(DATA_ARMS).get(name))


def sample(robot, count, seed=0):
    """Random configurations (count, n) and their poses (count, 4, 4) by Pinocchio."""
    rng = np.random.default_rng(seed)
    Q = np.array([robot.random_q(rng) for _ in range(count)])
    return Q, np.array([robot.fk(q).homogeneous for q in Q])


def product(*names):
    """All pairs of two lists, as a list."""
    return list(itertools.product(*names))
