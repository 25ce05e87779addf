"""The rate of the Jacobian against Pinocchio and against differences."""

import numpy as np
import pinocchio as pin
import pytest
from references import MIMIC

from ik_toolkit.compile.jit import cached
from ik_toolkit.kernel import kinematics
from ik_toolkit.kernel.algebra import at3
from ik_toolkit.kernel.kinematics import fk, own_coordinates, room
from ik_toolkit.kernel.problem import fill
from ik_toolkit.kernel.records import SIZE
from ik_toolkit.robot.robot import Robot


@cached
def _rate(rows, ends, q, x, y, out):
    n = q.shape[0]
    size, angles = room(rows.shape[0])
    joints, trig, J = np.empty(size), np.zeros(angles), np.empty((n, 6))
    now = fk(rows, q, joints, trig)
    tip = now.point + now.axes.times(at3(ends, 21))
    fill(rows, own_coordinates(rows, n), np.zeros(SIZE.task), np.empty(0), joints, tip, J, 0)
    kinematics.jacobian_rate(rows, joints, J, 0, tip, x, y, out)


def jacobian_rate(robot, q, x, y):
    """(dJ/dt along x) y by the kernel, base axes, metres."""
    chain, out = robot.chain, np.empty(6)
    ends = chain.ends
    _rate(chain.rows, ends, q / chain.unit, x / chain.unit, y / chain.unit, out)
    base = ends[:9].reshape(3, 3)
    return np.concatenate([base @ out[:3] * chain.scale, base @ out[3:]])


@pytest.mark.parametrize("name", ["panda", "hydrolek_7w", "inspection_7dof", "planar_2r", "cartesian_pp"])
def test_jacobian_rate_is_pinocchios(name):
    robot = Robot.load(name)
    model, data = robot.model, robot.model.createData()
    path = [model.joints[model.getJointId(j)].idx_v for j in robot.joint_names]
    frame = model.getFrameId(robot.tip, pin.FrameType.BODY)
    rng = np.random.default_rng(3)
    for _ in range(20):
        q, x, y = robot.random_q(rng), rng.normal(size=robot.n), rng.normal(size=robot.n)
        v = np.zeros(model.nv)
        v[path] = x
        full = robot.to_pinocchio(q)
        pin.computeJointJacobiansTimeVariation(model, data, full, v)
        pin.updateFramePlacements(model, data)
        dJ = pin.getFrameJacobianTimeVariation(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:, path]
        assert jacobian_rate(robot, q, x, y) == pytest.approx(dJ @ y, abs=1e-12)
        pin.forwardKinematics(model, data, full, v, np.zeros(model.nv))
        a = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        assert jacobian_rate(robot, q, x, x) == pytest.approx(a, abs=1e-12)


def test_jacobian_rate_with_mimic_slide_base_and_tool():
    """Against differences of Pinocchio's Jacobian, on what the direct comparison cannot take."""
    tool = pin.SE3(pin.exp3(np.array([0.2, 0.1, -0.4])), np.array([0.1, 0.2, 0.05])).homogeneous
    robots = (
        Robot.load(MIMIC),
        Robot.load(MIMIC).with_tool(tool),
        Robot.load("brokk_hydrolek", tip="left_tip"),
        Robot.load("inspection_7dof", base="link_1"),
    )
    rng = np.random.default_rng(4)
    for robot in robots:
        for _ in range(5):
            q, x, y = robot.random_q(rng), rng.normal(size=robot.n), rng.normal(size=robot.n)
            h = 1e-5
            dJ = (robot.jacobian(q + h * x) - robot.jacobian(q - h * x)) / (2 * h)
            assert jacobian_rate(robot, q, x, y) == pytest.approx(dJ @ y, abs=1e-7)
