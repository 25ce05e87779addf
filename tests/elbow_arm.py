"""An arm of two joints whose second one is written as a test likes it."""

import numpy as np
from second_fk import SecondFK, pose_errors

import ik_toolkit as ik
from ik_toolkit.robot.check import check_urdf

LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
TURN = 'quat_xyzw="0.1 -0.2 0.3 0.9"'


def arm(
    elbow='<origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>' + LIMIT,
    kind="revolute",
    robot="",
    extra="",
    head="",
    name="elbow",
):
    """Two joints; `elbow` is inside the second one, which begins in line 4."""
    return (
        f'{head}<robot name="arm"{robot}><link name="base"/><link name="upper"/><link name="hand"/>{extra}'
        '<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/>'
        f'<axis xyz="0 0 1"/>{LIMIT}</joint>\n\n\n'
        f'<joint name="{name}" type="{kind}"><parent link="upper"/><child link="hand"/>\n{elbow}</joint></robot>'
    )


def elbow(origin='<origin xyz="0.4 0 0"/>', axis='<axis xyz="0 1 0"/>', limit=LIMIT, **options):
    return arm(f"{origin}{axis}{limit}", **options)


def said(text):
    """Elements and problems that check reports, each with its line."""
    return [(finding.line, str(finding)) for finding in check_urdf(text)]


def same_fk(text, seed=0, **options):
    """The robot of a text, whose FK is that of the second reader."""
    robot = ik.Robot.load(text, **options)
    Q = robot.random_q(np.random.default_rng(seed), 5)
    T = np.array([robot.fk(q).homogeneous for q in Q])
    position, angle = pose_errors(T, SecondFK(text, robot.base, robot.tip).fk(Q, robot.joint_names))
    assert position.max() < 1e-12 and angle.max() < 1e-12
    return robot
