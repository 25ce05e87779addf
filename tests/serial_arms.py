"""Shared by the closed-form tests: serial chains as URDF text, and distances between solutions."""

import math

import numpy as np

import ik_toolkit as ik


def apart(a, b):
    """Largest joint difference, angles modulo turns (all rows of `a` against all of `b`)."""
    d = np.abs(np.asarray(a)[:, None] - np.asarray(b)[None])
    return np.minimum(d, np.abs(2 * math.pi - d)).max(axis=2)


def away(Q, q):
    """Largest joint difference (...) of Q (..., n) and q (n,), without full turns."""
    return np.abs((np.asarray(Q) - q + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)


def anywhere(robot, rng):
    """A pose of six revolute joints at any angles, most likely reached only beyond a limit."""
    return robot.fk(rng.uniform(-np.pi, np.pi, 6)).homogeneous


def urdf(joints, tool):
    """URDF of a serial chain: joints are (type, xyz, rpy, axis, lower, upper)."""
    parts, parent = ['<robot name="drawn"><link name="base"/>'], "base"
    text = lambda v: " ".join(repr(float(x)) for x in v)  # noqa: E731
    for k, (kind, xyz, rpy, axis, low, high) in enumerate(joints):
        parts.append(
            f'<link name="l{k}"/><joint name="j{k}" type="{kind}"><parent link="{parent}"/><child link="l{k}"/>'
            f'<origin xyz="{text(xyz)}" rpy="{text(rpy)}"/><axis xyz="{text(axis)}"/>'
            f'<limit lower="{low!r}" upper="{high!r}" effort="1" velocity="1"/></joint>'
        )
        parent = f"l{k}"
    parts.append(
        f'<link name="tip"/><joint name="end" type="fixed"><parent link="{parent}"/><child link="tip"/>'
        f'<origin xyz="{text(tool[0])}" rpy="{text(tool[1])}"/></joint></robot>'
    )
    return "".join(parts)


def drawn(joints, xyz, rpy=(0, 0, 0)):
    """The robot of `urdf`; its tool is at xyz [m] and rpy [rad] from the last joint."""
    return ik.Robot.load(urdf(joints, (xyz, rpy)), tip="tip")
