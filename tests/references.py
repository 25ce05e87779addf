"""A moving target and an arm with every kind of joint, shared by the tracking tests."""

import numpy as np
import pinocchio as pin

import ik_toolkit as ik

MIMIC = """<robot name="mimic"><link name="b"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="tip"/>
<joint name="a" type="revolute"><parent link="b"/><child link="l1"/><origin xyz="0.1 0 0.3" rpy="0.2 0.4 0"/><axis xyz="0 0.6 0.8"/>
<limit lower="-2" upper="2" velocity="2" effort="1"/></joint>
<joint name="s" type="prismatic"><parent link="l1"/><child link="l2"/><origin xyz="0.2 0.1 0" rpy="0 0.5 0"/><axis xyz="1 0 0"/>
<limit lower="-0.5" upper="0.5" velocity="1" effort="1"/></joint>
<joint name="f" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0 0.3 0.1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="2" effort="1"/><mimic joint="a" multiplier="-0.7" offset="0.3"/></joint>
<joint name="w" type="continuous"><parent link="l3"/><child link="tip"/><origin xyz="0.3 0 0" rpy="0.1 0 0.2"/>
<axis xyz="0.8 0 0.6"/><limit velocity="3" effort="1"/></joint></robot>"""
Q0 = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])


def panda_reference(robot, pose, duration=12.6):
    """Circle of 0.1 m from the tip at Q0, 1 rad/s, world xy; the pose also tilts by 0.3 sin t about y."""
    T0 = robot.fk(Q0).homogeneous

    def function(t):
        T, V, A = np.tile(np.eye(4), (len(t), 1, 1)), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        T[:, :3, 3] = T0[:3, 3] + 0.1 * np.stack([np.cos(t) - 1, np.sin(t), 0 * t], 1)
        V[:, 0], V[:, 1] = -0.1 * np.sin(t), 0.1 * np.cos(t)
        A[:, 0], A[:, 1] = -0.1 * np.cos(t), -0.1 * np.sin(t)
        T[:, :3, :3] = T0[:3, :3]
        if pose:
            T[:, :3, :3] = [pin.exp3(np.array([0.0, 0.3 * np.sin(x), 0.0])) @ T0[:3, :3] for x in t]
            V[:, 4], A[:, 4] = 0.3 * np.cos(t), -0.3 * np.sin(t)
        return T, V, A

    return ik.Reference(function, duration, position_only=not pose)


def most_turns(Q, limits, h=0.01):
    """Most times that a joint of Q (N, n) turns back within 0.1 s, at 5 % of its speed limit or more."""
    rates, most = np.diff(Q, axis=0) / h / limits, 0
    for one in rates.T:
        fast = np.flatnonzero(np.abs(one) > 0.05)
        turns = fast[1:][np.diff(np.sign(one[fast])) != 0.0]
        most = max([most, *(int(((turns >= k) & (turns < k + round(0.1 / h))).sum()) for k in turns)])
    return most


def accelerations(robot):
    """Limits with which the joints are at full speed after 0.2 s."""
    return 5.0 * robot.velocity_limits


def keeps_limits(robot, Q, h, acceleration=np.inf):
    """Whether positions, speeds and accelerations of joint values (N, n) from rest on keep their limits at every sample."""
    speed = np.diff(Q, axis=0, prepend=Q[:1]) / h
    top = np.where(robot.velocity_limits > 0.0, robot.velocity_limits, np.inf)
    return (
        ((robot.lower <= Q) & (robot.upper >= Q)).all()
        and (np.abs(speed) <= top * (1.0 + 1e-9)).all()
        and (np.abs(np.diff(speed, axis=0)) <= acceleration * h * (1.0 + 1e-9)).all()
    )


def least_time(robot, way, a=None):
    """Least time [s] the joints need for a way, from rest to rest; a (n,): their accelerations, if limited."""
    way, v = np.abs(way), robot.velocity_limits
    if a is None:
        return float((way / v).max())
    return float(np.where(way > v * v / a, way / v + v / a, 2.0 * np.sqrt(way / a)).max())


def line_of(robot, q, way, duration, law="minimum-jerk", free=False):
    """Straight line of the tip from where it is at q; its orientation is kept, or free."""
    start, way = robot.fk(q), np.array(way)
    if free:
        return ik.line(start.translation, start.translation + way, duration=duration, law=law)
    return ik.line(start, pin.SE3(start.rotation, start.translation + way), duration=duration, law=law)
