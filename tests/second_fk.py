"""A second forward kinematics, from the URDF text with numpy alone: it judges Pinocchio, the kernel and the solvers.

It shares nothing with the package: no Pinocchio, no kernel, no screw is read from anything but the text. Also here: the
true errors of a pose, and a maker of URDFs as people write them.
"""

import math
import xml.etree.ElementTree as ET
from typing import NamedTuple

import numpy as np

TURN = 2.0 * math.pi


def numbers(text, default):
    """Floats of an attribute, or the default when it is missing."""
    return np.array([float(word) for word in text.split()]) if text is not None else np.array(default, dtype=float)


def cross_matrix(v):
    """Return K with K x = v x x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turn_about(axis, angle):
    """Rotation (3, 3) about a unit axis (Rodrigues)."""
    K = cross_matrix(axis)
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)


def origin(joint):
    """Pose (R, p) of a joint in its parent link: rotation Rz(yaw) Ry(pitch) Rx(roll) or that of quat_xyzw, point [m]."""
    found = joint.find("origin")
    if found is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = numbers(found.get("rpy"), (0.0, 0.0, 0.0))
    x, y, z = np.eye(3)
    if found.get("quat_xyzw") is not None:
        *vector, cos = numbers(found.get("quat_xyzw"), ())
        sin = math.hypot(*vector)
        turned = turn_about(np.array(vector) / sin, 2.0 * math.atan2(sin, cos)) if sin > 0.0 else np.eye(3)
        return turned, numbers(found.get("xyz"), (0.0, 0.0, 0.0))
    return turn_about(z, yaw) @ turn_about(y, pitch) @ turn_about(x, roll), numbers(found.get("xyz"), (0.0, 0.0, 0.0))


def across(axis):
    """Axis and angle of the shortest rotation of z onto a unit axis (about x where they are opposite)."""
    side = np.array([-axis[1], axis[0], 0.0])
    sin = math.hypot(*side)
    return (side / sin if sin > 0.0 else np.array([1.0, 0.0, 0.0])), math.atan2(sin, axis[2])


class SecondFK:
    """Forward kinematics of one path of a URDF, for many configurations at once.

    urdf_text: the file; base, tip: link names; rest: values of joints held off zero [rad or m]; tool (4, 4): moves the tip.
    """

    def __init__(self, urdf_text, base=None, tip=None, rest=None, tool=None):
        root = ET.fromstring(urdf_text.encode())
        self.joints = {joint.get("name"): joint for joint in root.findall("joint")}
        self.above = {joint.find("child").get("link"): name for name, joint in self.joints.items()}
        links = [link.get("name") for link in root.findall("link")]
        self.base = base if base is not None else next(link for link in links if link not in self.above)
        self.tip = tip if tip is not None else links[-1]
        self.rest = dict(rest or {})
        self.tool = np.eye(4) if tool is None else np.asarray(tool, dtype=float)
        up, down = self._ancestors(self.base), self._ancestors(self.tip)
        while up and down and up[-1] == down[-1]:
            up.pop()
            down.pop()
        self.up, self.down = up[::-1], down[::-1]  # from the last common link outwards

    def _ancestors(self, link):
        names = []
        while link in self.above:
            names.append(self.above[link])
            link = self.joints[names[-1]].find("parent").get("link")
        return names

    def kind(self, name):
        """Type of a joint."""
        return self.joints[name].get("type")

    def leads(self, name):
        """Leader, multiplier and offset with value(name) = multiplier value(leader) + offset; mimic of mimic is followed."""
        mimic = self.joints[name].find("mimic")
        if mimic is None:
            return name, 1.0, 0.0
        ratio, offset = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))
        leader, r, o = self.leads(mimic.get("joint"))
        return leader, ratio * r, ratio * o + offset

    def values(self, name, Q, joint_names):
        """Values (N,) of a joint at Q (N, n), or one number when nothing moves it."""
        leader, ratio, offset = self.leads(name)
        if leader in joint_names:
            return ratio * Q[:, joint_names.index(leader)] + offset
        for follower in joint_names:  # a follower that is a coordinate says where its leader stands
            other, r, o = self.leads(follower)
            if other == leader:
                return ratio * (Q[:, joint_names.index(follower)] - o) / r + offset
        return ratio * self.rest.get(leader, 0.0) + offset

    def _part(self, name, part, Q, joint_names):
        """Values (N,) of a coordinate of a planar joint; that of the root is called base."""
        found = [i for i, joint in enumerate(joint_names) if joint in (f"{name}_{part}", f"base_{part}")]
        return Q[:, found[0]] if found else np.zeros(len(Q))

    def _out(self, path, Q, joint_names):
        """Rotation (N, 3, 3) and point (N, 3) of the end of a path in the last common link."""
        N = len(Q)
        R, p = np.broadcast_to(np.eye(3), (N, 3, 3)), np.zeros((N, 3))
        for name in path:
            joint = self.joints[name]
            fixed, point = origin(joint)
            p = p + R @ point
            R = (R.reshape(-1, 3) @ fixed).reshape(N, 3, 3)
            if self.kind(name) == "fixed":
                continue
            axis = numbers(None if joint.find("axis") is None else joint.find("axis").get("xyz"), (1.0, 0.0, 0.0))
            axis = axis / math.hypot(*axis)
            if self.kind(name) == "planar":  # two slides in the plane perpendicular to the axis, then a turn about it
                x, y, value = (self._part(name, part, Q, joint_names) for part in ("x", "y", "yaw"))
                sides = turn_about(*across(axis))
                p = p + x[:, None] * (R @ sides[:, 0]) + y[:, None] * (R @ sides[:, 1])
            else:
                value = np.asarray(self.values(name, Q, joint_names))
            if self.kind(name) == "prismatic":
                p = p + value[..., None] * (R @ axis)
                continue
            K = cross_matrix(axis)
            RK = (R.reshape(-1, 3) @ K).reshape(N, 3, 3)
            RKK = (RK.reshape(-1, 3) @ K).reshape(N, 3, 3)
            R = R + np.sin(value)[..., None, None] * RK + (2.0 * np.sin(0.5 * value) ** 2)[..., None, None] * RKK
        return R, p

    def fk(self, Q, joint_names):
        """T_base_tip (N, 4, 4) at Q (N, n), whose columns are the joints of `joint_names` [rad or m]."""
        Q, names = np.atleast_2d(np.asarray(Q)), list(joint_names)
        R, p = self._out(self.down, Q, names)
        if self.up:
            B, b = self._out(self.up, Q, names)
            R, p = B.transpose(0, 2, 1) @ R, np.einsum("nji,nj->ni", B, p - b)
        T = np.zeros((len(Q), 4, 4), dtype=np.result_type(R, p))
        T[:, 3, 3] = 1.0
        T[:, :3, :3] = R @ self.tool[:3, :3]
        T[:, :3, 3] = p + R @ self.tool[:3, 3]
        return T

    def jacobian(self, Q, joint_names):
        """Jacobians (N, 6, n) of the tip point in base axes, linear rows first: derivatives by complex steps, so exact."""
        Q = np.atleast_2d(Q).astype(complex)
        J = np.empty((len(Q), 6, Q.shape[1]))
        for i in range(Q.shape[1]):
            at = Q.copy()
            at[:, i] += 1e-30j  # too small to change the real part: the imaginary part is the derivative
            T = self.fk(at, joint_names)
            W = T.imag[:, :3, :3] @ np.swapaxes(T.real[:, :3, :3], 1, 2) * 1e30
            J[:, :3, i] = T.imag[:, :3, 3] * 1e30
            J[:, 3:, i] = 0.5 * np.stack(
                [W[:, 2, 1] - W[:, 1, 2], W[:, 0, 2] - W[:, 2, 0], W[:, 1, 0] - W[:, 0, 1]], axis=1
            )
        return J

    def limits(self, joint_names):
        """Lower and upper (n,) [rad or m] that the URDF allows, those of all followers included."""
        lower, upper = np.full(len(joint_names), -np.inf), np.full(len(joint_names), np.inf)
        for i, leader in enumerate(joint_names):
            for name in self.joints:
                led, ratio, offset = self.leads(name)
                limit = self.joints[name].find("limit")
                if led != leader or limit is None or self.kind(name) not in ("revolute", "prismatic") or ratio == 0.0:
                    continue
                ends = sorted((float(limit.get(side, 0.0)) - offset) / ratio for side in ("lower", "upper"))
                lower[i], upper[i] = max(lower[i], ends[0]), min(upper[i], ends[1])
        return lower, upper

    def outside(self, Q, joint_names):
        """Rows (N,) in which a joint or a follower stands outside its limits by more than the rounding of its own value.

        A joint of q is held to its limits exactly; a follower's value is rounded twice on the way.
        """
        Q, names = np.atleast_2d(Q), list(joint_names)
        bad = np.zeros(len(Q), dtype=bool)
        for name in self.joints:
            limit = self.joints[name].find("limit")
            leader, ratio, offset = self.leads(name)
            if limit is None or self.kind(name) not in ("revolute", "prismatic") or leader not in names:
                continue
            slack = 0.0
            if leader != name:
                slack = 4.0 * np.finfo(float).eps * (np.abs(ratio * Q[:, names.index(leader)]) + abs(offset))
            value = self.values(name, Q, names)
            bad |= ~(
                (value >= float(limit.get("lower", 0.0)) - slack) & (value <= float(limit.get("upper", 0.0)) + slack)
            )
        return bad

    def largest_offset(self):
        """Longest distance [m] from a joint on the path to the next, or to the tool's point."""
        lengths = [math.hypot(*origin(self.joints[name])[1]) for name in (*self.up, *self.down)]
        return max([math.hypot(*self.tool[:3, 3]), *lengths])


def angles_between(R, S):
    """Angle [rad] (N,) between rotations (N, 3, 3), accurate near 0 and pi."""
    D = np.swapaxes(R, -1, -2) @ S
    v = 0.5 * np.stack([D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], axis=-1)
    return np.arctan2(np.linalg.norm(v, axis=-1), 0.5 * (np.trace(D, axis1=-2, axis2=-1) - 1.0))


def pose_errors(T, target):
    """Position errors [m] and rotation angles [rad] (N,) of poses T (N, 4, 4) against targets (N, 4, 4), or positions (N, 3).

    The angles are 0 where the target is a position.
    """
    target = np.asarray(target, dtype=float)
    if target.shape[-1] == 3:
        return np.linalg.norm(T[:, :3, 3] - target, axis=1), np.zeros(len(T))
    return np.linalg.norm(T[:, :3, 3] - target[:, :3, 3], axis=1), angles_between(T[:, :3, :3], target[:, :3, :3])


# ------------------------------------------------------------------------------------------------------- random URDFs
RPY_LITERALS = (
    "0 1.57 -1.57 1.5707 -1.5707 1.57079632679 -1.57079632679 1.5707963267948966 -1.5707963267948966 "
    "3.14159 -3.14159 3.14159265359 -3.14159265359"
).split()
ANGLES = [
    *RPY_LITERALS,
    *"-0.0 3.1415 0.7853981634 -0.785 1.5708 3.1416 3.141592653589793 2.0943951".split(),
]
AXES = (
    "1 0 0, 0 1 0, 0 0 1, -1 0 0, 0 -1 0, 0 0 -1, -0.0 -0.0 1, -0.0 0 -1, 0 0 2, 1 1 0, 0 0.7071 -0.7071, 0.577 0.577 0.577, "
    "0.0000015 0 -1, 0 0.000001 -1, 1e-9 0 -1, 0 1e-9 1, 1 -3.67e-6 0, 4.9e-12 -1 0, 0.001 0 0"
).split(", ")


class Case(NamedTuple):
    """One random robot: what Robot.load and with_tool take, and its text."""

    text: str
    base: str
    tip: str
    locked: dict
    tool: np.ndarray | None

    def judge(self):
        """The second FK of the case."""
        return SecondFK(self.text, self.base, self.tip, self.locked, self.tool)


def _near(rng, literal):
    """A literal unchanged, or changed by 1e-12 to 1e-5."""
    if rng.random() < 0.7:
        return literal
    return repr(float(literal) + float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-12.0, -5.0)))


def _angle(rng):
    return _near(rng, str(rng.choice(ANGLES))) if rng.random() < 0.8 else repr(float(rng.uniform(-4.0, 4.0)))


def _axis(rng):
    if rng.random() < 0.8:
        return " ".join(_near(rng, x) if rng.random() < 0.2 else x for x in str(rng.choice(AXES)).split())
    return " ".join(repr(float(x)) for x in rng.normal(size=3))


def _triple(rng, size):
    """Offsets: some zero, some along one axis, some any."""
    xyz = rng.normal(size=3) * size
    xyz[rng.random(3) < rng.choice([0.0, 0.5, 0.8])] = 0.0
    return " ".join(repr(float(x)) for x in xyz)


def _limits(rng, kind, size):
    """Lower and upper [rad or m] of a joint."""
    if kind == "prismatic":
        low = float(rng.choice([0.0, -0.0, -size * rng.random()]))
        return low, low + float(rng.choice([0.0, size * rng.random(), 3.0 * size], p=[0.03, 0.77, 0.2]))
    choice = rng.random()
    if choice < 0.15:
        return -3.14159265359, 3.14159265359
    if choice < 0.25:
        return -2.0 * math.pi, 2.0 * math.pi
    if choice < 0.3:
        return 0.0, -0.0
    low = float(rng.uniform(-3.5, 0.5))
    return low, low + float(rng.uniform(0.1, 4.0))


def _mimic(rng, leader, leader_kind, between, kind, size):
    """A <mimic> of any size (revolute after revolute, after a slide (rad/m), a slide after either) and limits that fit."""
    ratio = float(rng.choice([1.0, -1.0, 0.5, 2.0, 20.0, rng.normal(), 10.0 ** rng.uniform(-4.0, 3.0)]))
    if kind == "prismatic":
        ratio *= size if leader_kind != "prismatic" else 1.0
        offset = size * float(rng.choice([0.0, rng.normal()]))
    else:
        ratio /= size if leader_kind == "prismatic" else 1.0
        offset = float(rng.choice([0.0, 3.14159265, -3.14159265359, 1.57, rng.normal(), rng.uniform(-30.0, 30.0)]))
    low, high = sorted(ratio * x + offset for x in between)
    wider = float(rng.choice([0.0, 0.1, -0.2])) * (high - low)  # the leader's own limits bind, or the follower's
    return f'<mimic joint="{leader}" multiplier="{ratio!r}" offset="{offset!r}"/>', (low - wider, high + wider)


def random_case(rng, most=40):
    """A random robot as people and exporters write them, with one moving joint to `most`.

    Besides the path there are side branches; the base may be any link of the path, joints may be locked and a tool may sit
    on the tip.
    """
    size = 10.0 ** rng.uniform(-6.0, 6.0) if rng.random() < 0.3 else 10.0 ** rng.uniform(-1.0, 0.5)
    count = int(rng.integers(1, most + 1)) if rng.random() < 0.3 else int(rng.integers(1, 9))
    links, parts, leaders, path = ["l0"], ['<link name="l0"/>'], [], []
    moving = 0
    while moving < count:
        i = len(parts) - 1
        kind = str(rng.choice(["revolute", "revolute", "revolute", "continuous", "prismatic", "fixed"]))
        branch = bool(links[1:]) and rng.random() < 0.1  # a joint beside the path
        parent, child = links[-1], f"l{i + 1}"
        mimic, limit, between = "", "", (-30.0, 30.0)
        if kind in ("revolute", "prismatic"):
            between = _limits(rng, kind, size)
        if kind != "fixed" and leaders and rng.random() < 0.2:
            mimic, between = _mimic(rng, *leaders[int(rng.integers(len(leaders)))], kind, size)
        if kind in ("revolute", "prismatic"):
            low, high = between
            limit = f'<limit lower="{low!r}" upper="{high!r}" effort="1" velocity="1"/>'
        rpy = " ".join(_angle(rng) if rng.random() < 0.6 else "0" for _ in range(3))
        parts.append(
            f'<link name="{child}"/><joint name="j{i}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{_triple(rng, size)}" rpy="{rpy}"/><axis xyz="{_axis(rng)}"/>{limit}{mimic}</joint>'
        )
        if kind != "fixed" and not mimic:
            leaders.append((f"j{i}", kind, between))
        if not branch:
            links.append(child)
            if kind != "fixed" and not mimic:
                path.append((f"j{i}", kind))
                moving += 1
    base = links[int(rng.integers(len(links) // 2))] if len(links) > 3 and rng.random() < 0.2 else "l0"
    tool, locked = None, {}
    if rng.random() < 0.2:
        tool = np.eye(4)
        tool[:3, :3] = turn_about(np.array([0.6, 0.0, 0.8]), rng.uniform(-3.0, 3.0))
        tool[:3, 3] = rng.normal(size=3) * size
    below = path[1:] if base == "l0" else []
    if below and rng.random() < 0.2:
        joint, kind = below[int(rng.integers(len(below)))]
        locked = {joint: float(rng.normal() * (size if kind == "prismatic" else 1.0))}
    return Case(f'<robot name="random">{"".join(parts)}</robot>', base, links[-1], locked, tool)
