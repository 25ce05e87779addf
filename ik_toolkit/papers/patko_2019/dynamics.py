"""Eqs. (1) to (4) of Patko and Zelei (2019): inverse-dynamics control, computed by Pinocchio's recursive Newton-Euler."""

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ...robot.robot import Robot
from ..report import Report

# Mass [kg], length [m] and radius [m] of a link. They are our choice, because the paper gives none.
MASS, LENGTH, RADIUS = 2.0, 1.0, 0.03
GRAVITY = (0.0, -9.81, 0.0)  # Gravity [m/s^2] is in the plane of the arm, so that it loads the joints.
SHIFT = np.array([0.1, -0.05])  # Error [rad] of the two joints at the start of a simulation.
STEP, STEPS = 1e-3, 4000  # Time step [s] and number of steps of a simulation.
HEAVIER = 1.2  # In the second simulation the true masses are this many times those that the controller assumes.

Path = Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]]


def heavy_arm(mass: float = MASS) -> pin.Model:
    """Make a Pinocchio model with masses of a planar arm with two slender links, in a vertical plane."""
    model = Robot.load("planar_2r").model.copy()
    link = pin.Inertia.FromCylinder(mass, RADIUS, LENGTH)  # Along z; it is turned below, because the links are along x.
    along_x = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.array([0.5 * LENGTH, 0.0, 0.0]))
    for joint in (1, 2):
        model.inertias[joint] = along_x.act(link)
    model.gravity.linear = np.array(GRAVITY)
    return model


def swing(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the desired joint angles at time t [s], with their first and second derivatives."""
    a, w = np.array([0.6, 0.4]), np.array([1.0, 1.7])
    return a * np.sin(w * t), a * w * np.cos(w * t), -a * w * w * np.sin(w * t)


def follow(model: pin.Model, controller: pin.Model, kp: float, kd: float, path: Path = swing) -> np.ndarray:
    """Simulate `model` by Runge-Kutta under the control u = M v + C of eq. (2), in which M and C are those of `controller`.

    path: desired joint motion q_d over time. Returns the errors q - q_d (STEPS + 1, 2) [rad].
    """
    data, known = model.createData(), controller.createData()

    def acceleration(t: float, q: np.ndarray, rate: np.ndarray) -> np.ndarray:
        desired, speed, change = path(t)
        v = change - kd * (rate - speed) - kp * (q - desired)
        return pin.aba(model, data, q, rate, pin.rnea(controller, known, q, rate, v))

    q, rate, _ = path(0.0)
    q = q + SHIFT
    errors = [q - path(0.0)[0]]
    h = STEP
    for k in range(STEPS):
        t = k * h
        k1 = acceleration(t, q, rate)
        k2 = acceleration(t + h / 2, q + h / 2 * rate, rate + h / 2 * k1)
        k3 = acceleration(t + h / 2, q + h / 2 * rate + h * h / 4 * k1, rate + h / 2 * k2)
        k4 = acceleration(t + h, q + h * rate + h * h / 2 * k2, rate + h * k3)
        q = q + h * rate + h * h / 6 * (k1 + k2 + k3)
        rate = rate + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        errors.append(q - path(t + h)[0])
    return np.array(errors)


def linear_error(kp: float, kd: float) -> np.ndarray:
    """Return the exact solution (STEPS + 1, 2) of eq. (4), e'' + kd e' + kp e = 0, from SHIFT at rest."""
    roots = np.roots([1.0, kd, kp]).astype(complex)
    weights = np.array([-roots[1], roots[0]]) / (roots[0] - roots[1])
    t = STEP * np.arange(STEPS + 1)
    return (weights[0] * np.exp(roots[0] * t) + weights[1] * np.exp(roots[1] * t)).real[:, None] * SHIFT


def cancellation(model: pin.Model, count: int = 100, seed: int = 0) -> float:
    """Return the largest |qdd - v| [rad/s^2] under u = M v + C, eqs. (1) to (3), over random states and inputs."""
    rng = np.random.default_rng(seed)
    data = model.createData()
    worst = 0.0
    for _ in range(count):
        q, rate, v = rng.uniform(-2.0, 2.0, (3, model.nv))
        worst = max(worst, float(np.abs(pin.aba(model, data, q, rate, pin.rnea(model, data, q, rate, v)) - v).max()))
    return worst


def dynamics(made: Report, sets: dict[str, tuple[float, float]]) -> None:
    """Add the section on inverse dynamics to the report; sets of gains (kp [1/s^2], kd [1/s]) are given by name."""
    made.heading("Eqs. (1) to (4): the auxiliary input of inverse dynamics")
    model = heavy_arm()
    off = made.number("cancellation", cancellation(model))
    rows = []
    for name, (kp, kd) in sets.items():
        wanted = linear_error(kp, kd)
        exact, wrong = (follow(arm, model, kp, kd) for arm in (model, heavy_arm(HEAVIER * MASS)))
        late = slice(STEPS // 2, None)
        rows.append([name, kp, kd, np.abs(exact - wanted).max(), np.abs(exact[late]).max(), np.abs(wrong[late]).max()])
    head = ["gains", "P", "D", "largest difference to eq. (4)", "error left", f"error left, masses {HEAVIER:g} x"]
    made.table("dynamics", head, rows)
    made.text(
        f"""The paper takes its idea from inverse-dynamics control and prints no numbers for it. Here: two slender links of
        {MASS:g} kg and {LENGTH:g} m in a vertical plane, H = I, u = M v + C by Pinocchio's `rnea`, the motion by `aba` and
        Runge-Kutta with {1000 * STEP:g} ms. At 100 random states the closed loop has the commanded acceleration within
        {max(off, 1e-12):.0e}
        rad/s^2, eq. (3). Along a swing of both joints, {np.degrees(SHIFT[0]):.1f} and {np.degrees(SHIFT[1]):.1f} deg off at the
        start, the errors (rad) follow eq. (4) up to the rounding of the integration; 'error left' is the largest in the second
        half of {STEP * STEPS:g} s. With masses {HEAVIER:g} times those the controller assumes, eq. (4) no longer holds and an error
        remains: the cancellation is only as good as the model."""
    )
