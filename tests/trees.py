"""Robots with several tips that tests share."""

import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik


def mixed(size=1.0):
    """URDF of a torso that turns and lifts and two arms with followers, slides and an endless joint; lengths times `size`."""

    def arm(side, y, kinds):
        text, parent = "", "chest"
        for k, (kind, axis, mimic) in enumerate(kinds):
            xyz = f"{0.1 * size} {y * size if k == 0 else 0.0} {0.15 * size}"
            limits = (-0.2 * size, 0.3 * size) if kind == "prismatic" else (-1.6, 1.8)
            name = f"{side}{k}"
            text += robots.joint(name, kind, parent, f"{name}_link", axis, xyz, f"{0.1 * k} 0.2 0", limits, mimic)
            parent = f"{name}_link"
        return text + robots.joint(f"{side}_end", "fixed", parent, f"{side}_tip", xyz=f"0 0 {0.1 * size}")

    left = [
        ("revolute", "0 0 1", ""),
        ("revolute", "0 1 0", ""),
        ("prismatic", "1 0 0", robots.tie("turn", 0.05 * size, 0.02 * size)),
        ("prismatic", "1 0 0", ""),
        ("revolute", "1 0 0", ""),
        ("continuous", "0 1 0", ""),
        ("revolute", "0 0 1", ""),
    ]
    right = [
        ("revolute", "0 1 0", ""),
        ("revolute", "0 0 1", ""),
        ("revolute", "0 1 0", robots.tie("lift", 0.8 / size, 0.1)),
        ("revolute", "1 0 0", ""),
        ("revolute", "0 1 0", ""),
        ("revolute", "1 0 0", ""),
        ("revolute", "0 0 1", ""),
    ]
    torso = robots.joint("turn", "revolute", "base", "turning", limits=(-2.0, 2.0), xyz=f"0 0 {0.2 * size}")
    torso += robots.joint("lift", "prismatic", "turning", "chest", limits=(0.0, 0.4 * size), xyz=f"0 0 {0.2 * size}")
    return robots.branches(torso, arm("left", 0.2, left), arm("right", -0.2, right), root="base", name="mixed")


TREES = {
    "brokk_hydrolek": ["left_tip", "right_tip"],
    "mixed": ["left_tip", "right_tip"],
    "talos": ["gripper_left_base_link", "gripper_right_base_link"],
}


def tree_of(name):
    if name == "talos" and not robots.have_data():
        pytest.skip("example-robot-data is not installed")
    return ik.Tree.load(mixed() if name == "mixed" else name, tips=TREES[name])


def poses(tree, q):
    return [T.homogeneous for T in tree.fk(q).values()]


def direct(tree, q):
    """Poses of the tips by Pinocchio from the model's full configuration alone."""
    data = tree.model.createData()
    pin.framesForwardKinematics(tree.model, data, tree.to_pinocchio(q))
    base = data.oMf[tree.model.getFrameId(tree.base)]
    return [base.actInv(data.oMf[tree.model.getFrameId(tip)]).homogeneous for tip in tree.tips]
