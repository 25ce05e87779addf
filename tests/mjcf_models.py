"""Random MJCF models with limited balls, chained equalities and fixed tendons, and MuJoCo as the judge of what is made of them."""

import re

import mujoco
import numpy as np

SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def random_mjcf(rng):
    """Text of an arm of 2 to 7 joints whose last body has the site 'tip', with ties between its joints and those beside it."""
    count, body, joints = int(rng.integers(2, 8)), "", []
    slack = 0 if rng.random() < 0.3 else 1
    for i in range(count):
        kind = str(rng.choice(["hinge", "hinge", "slide", "ball"]))
        low, high = float(rng.uniform(-120, -20)), float(rng.uniform(20, 120))
        ref = float(rng.choice([0.0, rng.uniform(-0.2, 0.2)]))
        if kind == "ball":
            text = f'<joint name="j{i}" type="ball" range="0 {rng.uniform(10, 170):.4f}" pos="{_triple(rng, 0.05)}"/>'
        else:
            if kind == "slide":
                low, high = low / 200.0, high / 200.0
            text = (
                f'<joint name="j{i}" type="{kind}" axis="{_triple(rng, 1.0)}" pos="{_triple(rng, 0.05)}" '
                f'range="{low!r} {high!r}" ref="{ref if kind == "slide" else float(np.degrees(ref))!r}"/>'
            )
            joints.append((f"j{i}", kind))
        turn = " ".join(f"{x:.6f}" for x in rng.uniform(-180, 180, 3))
        beside = ""
        if rng.random() < 0.4:  # a finger beside the path
            beside = f'<body pos="{_triple(rng, 0.2)}"><geom size="0.01"/><joint name="s{i}" axis="0 1 0" range="-150 150"/></body>'
            joints.append((f"s{i}", "hinge"))
        body += f'<body pos="{_triple(rng, 0.3)}" euler="{turn}"><geom size="0.01"/>{text}{beside}'
    body += '<site name="tip" pos="0.1 0.02 0.05"/>' + "</body>" * count
    ties, tendons = _ties(rng, joints, slack)
    return f"<mujoco><worldbody>{body}</worldbody><tendon>{tendons}</tendon><equality>{ties}</equality></mujoco>"


def _triple(rng, size):
    return " ".join(f"{x:.6f}" for x in rng.normal(size=3) * size)


def _ties(rng, joints, most):
    """Equalities in any order, and the tendons they need; `most` of them may tie three joints."""
    names = [name for name, _ in joints]
    ties, tendons = [], ""
    for k in range(int(rng.integers(0, 4)) if len(names) > 1 else 0):
        a, b = (str(x) for x in rng.choice(names, 2, replace=False))
        ratio, offset = float(rng.choice([1.0, -1.0, 0.0, rng.normal()])), float(rng.normal() * 0.05)
        kind = rng.random()
        if kind < 0.45:
            ties.append(f'<joint joint1="{a}" joint2="{b}" polycoef="{offset!r} {ratio!r} 0 0 0"/>')
        elif kind < 0.6:
            ties.append(f'<joint joint1="{a}" polycoef="{offset!r} 0 0 0 0"/>')
        elif kind < 0.9 or not most:
            tendons += (
                f'<fixed name="t{k}"><joint joint="{a}" coef="1"/><joint joint="{b}" coef="{rng.normal():.5f}"/></fixed>'
                f'<fixed name="u{k}"><joint joint="{b}" coef="0.7"/></fixed>'
            )
            second = f'tendon2="u{k}" ' if rng.random() < 0.5 else ""
            ties.append(f'<tendon tendon1="t{k}" {second}polycoef="{offset!r} {ratio!r} 0 0 0"/>')
        else:
            parts = "".join(f'<joint joint="{name}" coef="{rng.normal():.5f}"/>' for name in names[:3])
            tendons += f'<fixed name="t{k}" limited="true" range="-0.5 0.5">{parts}</fixed>'
    rng.shuffle(ties)
    if len(names) and rng.random() < 0.3:
        tendons += f'<fixed name="v" limited="true" range="-0.3 0.4"><joint joint="{names[0]}" coef="-1.5"/></fixed>'
    return "".join(ties), tendons


class Judge:
    """MuJoCo's own model of a text: where the tip is, and by how much a configuration breaks limits and equalities."""

    def __init__(self, text):
        self.model = mujoco.MjModel.from_xml_string(text)
        self.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self.data = mujoco.MjData(self.model)

    def put(self, names, q, said=""):
        """Set the joints of q; those that are not in it go where MuJoCo's equalities want them.

        said: a result's notice, which gives values of joints that close loops ("kept with s1 = 0.3").
        """
        m, d, values = self.model, self.data, dict(zip(names, q, strict=True))
        values |= {name: float(x) for name, x in re.findall(r"(\w+) = ([-+.\de]+\d)", said)}
        d.qpos[:] = m.qpos0
        unknown = []
        for j in range(m.njnt):
            name, at = m.joint(j).name, m.jnt_qposadr[j]
            if m.jnt_type[j] in SCALAR:
                if name in values:
                    d.qpos[at] = values[name]
                else:
                    unknown.append((at, m.jnt_dofadr[j]))
                continue
            if f"{name}_angle" in values:
                azimuth, tilt, angle = (values[f"{name}_{part}"] for part in ("azimuth", "tilt", "angle"))
                axis = np.array([np.cos(azimuth) * np.sin(tilt), np.sin(azimuth) * np.sin(tilt), np.cos(tilt)])
                d.qpos[at : at + 4] = [np.cos(0.5 * angle), *(np.sin(0.5 * angle) * axis)]
            else:
                d.qpos[at : at + 4] = 1.0, 0.0, 0.0, 0.0
                for part, axis in (("yaw", (0, 0, 1)), ("pitch", (0, 1, 0)), ("roll", (1, 0, 0))):
                    turn, made = np.zeros(4), np.zeros(4)
                    mujoco.mju_axisAngle2Quat(turn, np.array(axis, dtype=float), values[f"{name}_{part}"])
                    mujoco.mju_mulQuat(made, d.qpos[at : at + 4].copy(), turn)
                    d.qpos[at : at + 4] = made
        for _ in range(3):
            off, J = self.equalities()
            if not unknown or not len(off):
                break
            where, columns = (np.array(x) for x in zip(*unknown, strict=True))
            d.qpos[where] -= np.linalg.lstsq(J[:, columns], off, rcond=None)[0]
        mujoco.mj_forward(m, d)

    def equalities(self):
        """Residuals of the equalities and their derivatives (., nv) where the joints are now."""
        m, d = self.model, self.data
        mujoco.mj_forward(m, d)
        own = d.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        return d.efc_pos[own].copy(), d.efc_J.reshape(-1, m.nv)[own].copy()

    def broken(self):
        """Largest excess over a limit or an equality [m or rad]."""
        m, d = self.model, self.data
        worst = np.abs(self.equalities()[0]).max(initial=0.0)
        for j in np.flatnonzero(m.jnt_limited):
            at, (low, high) = m.jnt_qposadr[j], m.jnt_range[j]
            x = d.qpos[at]
            if m.jnt_type[j] not in SCALAR:
                x = 2.0 * np.arctan2(np.linalg.norm(d.qpos[at + 1 : at + 4]), abs(x))
            worst = max(worst, low - x, x - high)
        for t in np.flatnonzero(m.tendon_limited):
            low, high = m.tendon_range[t]
            worst = max(worst, low - d.ten_length[t], d.ten_length[t] - high)
        return float(worst)
