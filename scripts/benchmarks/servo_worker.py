"""One tracking method in its own process: follows streams of targets sample by sample and times every step itself.

Started by servo.py with the Python of the method's own environment, where ik_toolkit need not exist; it needs numpy only.
Protocol: one JSON object a line on stdin and stdout. {"do": "follow", "adapter": ..., "input": npz, "output": npz, ...} runs
one stream. All methods get the same: targets (N, F, 4, 4) of F tips, each to be reached at the end of its sample; dt, start,
limits of position, speed and acceleration. None gets the target's velocity. The answer: commands Q (N + 1, n), rates R
(N + 1, n), seconds (N,).

A stepper has `step(target, measured)`, which returns the next command (n,) and is what is timed. `measured` is None or where
the joints are. `lock(joint)`: from now on this joint stands still.
"""
# ruff: noqa: D102  (what step and lock do is said above)

import json
import os
import sys
import traceback
from time import perf_counter
from types import SimpleNamespace

import numpy as np

DAMPING = 0.05  # of the plain damped step and the Toolbox's, m and rad; a common choice for arms of about a metre
PARSE = 0.1  # gamma of J-PARSE as in its authors' code: share of the largest singular value below which one is singular
RADIUS = 0.2  # m; one radian counts as this much, as in the judge
POSTURE = 1e-3  # weight of the start posture against the task, as in Pink's and mink's examples of one arm
LATE = 0.5  # gain of a step where what is measured is late: of 1, 0.5, 0.3 and 0.15 the best for Pink; 1 swings
STILL = 1e-8  # rad/s for a locked joint: the QP libraries take 0 for "no limit"


class Plain:
    """What steppers that answer a joint rate have in common: the last command, its rate, and clipping joint by joint."""

    gamma = 1.0
    relaxed = 0  # steps that had to leave out a limit

    def __init__(self, s):
        self.s, self.q, self.rate = s, s.q0.copy(), np.zeros(len(s.q0))
        self.lower, self.upper, self.speed = s.lower.copy(), s.upper.copy(), s.speed.copy()
        self.locked = np.ones(len(s.q0))
        self.gain = LATE if s.delay else 1.0

    def lock(self, joint):
        self.lower[joint] = self.upper[joint] = self.q[joint]
        self.rate[joint] = 0.0
        self.locked[joint] = 0.0

    def clipped(self, v):
        """Rate v inside speed and acceleration, then position limits, each joint on its own."""
        s = self.s
        v = np.clip(v, self.rate - s.acceleration * s.dt, self.rate + s.acceleration * s.dt)
        v = np.clip(v, -self.speed, self.speed)
        return np.clip(v, (self.lower - self.q) / s.dt, (self.upper - self.q) / s.dt)

    def move(self, v):
        """Take the step."""
        self.rate = v
        self.q = np.clip(self.q + v * self.s.dt, self.lower, self.upper)
        return self.q


class Damped(Plain):
    """Damped least squares (one step of Nakamura and Hanafusa's), each joint clipped on its own."""

    def __init__(self, s):
        import ik_toolkit as ik

        super().__init__(s)
        self.chain = load(ik, s).chain
        self.weight = np.tile([1.0] * 3 + [RADIUS] * 3, len(s.tips))

    def step(self, target, measured):
        at = self.q if measured is None else measured
        T, J = self.chain.forward(at[None], jacobian=True)
        e = np.concatenate([twist(t, goal) for t, goal in zip(T.reshape(-1, 4, 4), target, strict=True)])
        J, e = self.weight[:, None] * J[0], self.weight * e
        return self.move(self.clipped(self.gain * self.towards(J, e) / self.s.dt))

    def towards(self, J, e):
        """Joint move that closes the error e, by the weighted Jacobian."""
        return damped(J, e, RADIUS * DAMPING)


class Parse(Damped):
    """J-PARSE (Guptasarma, Strong, Zhen, Kennedy 2025), each joint clipped on its own: the paper has no limits.

    Of J = sum of sigma_k u_k v_k', directions with sigma_k <= s = gamma sigma_max are singular. Their part of the error is
    scaled by sigma_k / s and taken through 1 / s in place of 1 / sigma_k (its gain k is 1); the others are inverted as they are.
    """

    def towards(self, J, e):
        U, sigma, V = np.linalg.svd(J, full_matrices=False)
        border = PARSE * sigma[0]
        inverse = np.where(sigma > border, 1.0 / np.maximum(sigma, border), sigma / border**2)
        return V.T @ (inverse * (U.T @ e))


class Toolbox(Plain):
    """Robotics Toolbox: `p_servo` and a damped inverse of `jacob0`, each joint clipped on its own."""

    def __init__(self, s):
        import roboticstoolbox as rtb

        super().__init__(s)
        one_tip(s)
        self.servo, self.ets = rtb.p_servo, rtb.Robot.URDF(s.path).ets()

    def step(self, target, measured):
        at = self.q if measured is None else measured
        v, _ = self.servo(self.ets.eval(at), target[0], gain=self.gain / self.s.dt, method="angle-axis")
        return self.move(self.clipped(damped(self.ets.jacob0(at), v, DAMPING)))


class Pink(Plain):
    """Pink: a FrameTask a tip and its three limits, in one QP a step."""

    def __init__(self, s):
        import pink
        import pinocchio as pin
        import qpsolvers

        super().__init__(s)
        full = pin.buildModelFromUrdf(s.path)
        keep = {full.getJointId(name) for name in s.joints}
        fixed = [j for j in range(1, full.njoints) if j not in keep]
        model = pin.buildReducedModel(full, fixed, s.rest if len(s.rest) == full.nq else pin.neutral(full))
        self.order = np.array([model.joints[model.getJointId(name)].idx_q for name in s.joints])
        for values, place in ((s.lower, model.lowerPositionLimit), (s.upper, model.upperPositionLimit)):
            place[self.order] = values
        limit = np.empty(model.nv)
        limit[self.order] = s.speed
        model.velocityLimit = limit
        self.solver = "daqp" if "daqp" in qpsolvers.available_solvers else qpsolvers.available_solvers[0]
        self.library, self.pin = pink, pin
        self.configuration = pink.Configuration(model, model.createData(), self.full(s.q0))
        cost = {"position_cost": 1.0, "orientation_cost": RADIUS, "lm_damping": 1.0, "gain": self.gain}
        self.tasks = [pink.FrameTask(tip, **cost) for tip in s.tips]
        if s.posture:
            self.tasks.append(pink.PostureTask(cost=POSTURE))
            self.tasks[-1].set_target(self.full(s.q0))
        self.limits = [pink.limits.ConfigurationLimit(model), pink.limits.VelocityLimit(model)]
        self.last = None
        if np.isfinite(s.acceleration).all():
            most = np.empty(model.nv)
            most[self.order] = s.acceleration
            self.last = pink.limits.AccelerationLimit(model, most)
            self.limits.append(self.last)

    def full(self, q):
        out = np.zeros(len(q))
        out[self.order] = q
        return out

    def lock(self, joint):
        super().lock(joint)
        model, place = self.configuration.model, self.order[joint]
        most = model.velocityLimit.copy()
        most[place] = STILL
        model.velocityLimit = most
        self.limits[1] = self.library.limits.VelocityLimit(model)
        if self.last is not None:
            self.last.set_last_integration(self.full(self.rate), self.s.dt)

    def step(self, target, measured):
        s, pin = self.s, self.pin
        self.configuration.update(self.full(self.q if measured is None else measured))
        for task, T in zip(self.tasks, target, strict=False):
            task.set_target(pin.SE3(T[:3, :3], T[:3, 3]))
        v = self.solved()
        if self.last is not None:
            self.last.set_last_integration(v, s.dt)
        self.rate = v[self.order] * self.locked
        self.q = self.q + self.rate * s.dt
        return self.q

    def solved(self):
        """Rate (nv,) of its QP.

        Its acceleration limit can leave none where a joint brakes before a position limit: the step is then solved again without
        that limit, and counted.
        """
        one = {"solver": self.solver, "safety_break": False}
        try:
            return self.library.solve_ik(self.configuration, self.tasks, self.s.dt, limits=self.limits, **one)
        except self.library.exceptions.NoSolutionFound:
            if self.last is None:
                raise
        self.relaxed += 1
        return self.library.solve_ik(self.configuration, self.tasks, self.s.dt, limits=self.limits[:2], **one)


class Mink(Plain):
    """mink: a FrameTask and its limits (it has none of acceleration), in one QP a step."""

    def __init__(self, s):
        import mink
        import mujoco

        super().__init__(s)
        one_tip(s)
        keep = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco></robot>'
        with open(s.path, encoding="utf-8") as file:
            self.model = mujoco.MjModel.from_xml_string(file.read().replace("</robot>", keep))
        self.library, self.configuration = mink, mink.Configuration(self.model)
        cost = {"position_cost": 1.0, "orientation_cost": RADIUS, "lm_damping": 1.0, "gain": self.gain}
        self.tasks = [mink.FrameTask(s.tips[0], "body", **cost)]
        self.configuration.update(s.q0)
        if s.posture:
            self.tasks.append(mink.PostureTask(self.model, cost=POSTURE))
            self.tasks[-1].set_target(s.q0)
        self.bound()

    def bound(self):
        names = [self.model.joint(j).name for j in range(self.model.njnt)]
        speeds = dict(zip(names, self.speed.tolist(), strict=True))
        limits = self.library.ConfigurationLimit(self.model), self.library.VelocityLimit(self.model, speeds)
        self.limits = list(limits)

    def lock(self, joint):
        super().lock(joint)
        self.speed[joint] = STILL
        self.bound()

    def step(self, target, measured):
        s = self.s
        self.configuration.update(self.q if measured is None else measured)
        self.tasks[0].set_target(self.library.SE3.from_matrix(target[0]))
        self.rate = self.library.solve_ik(self.configuration, self.tasks, s.dt, solver="daqp", limits=self.limits)
        self.rate *= self.locked
        self.q = self.q + self.rate * s.dt
        return self.q


class Ours:
    """`ik.Tracker`."""

    relaxed = 0

    def __init__(self, s):
        import ik_toolkit as ik

        robot = load(ik, s)
        options = {"avoid_collisions": around(ik, robot, s)} if s.obstacles else {}
        limit = s.acceleration if np.isfinite(s.acceleration).any() else None
        self.tracker = ik.Tracker(
            robot, s.method, q0=s.q0, rate0=np.zeros(robot.n), acceleration_limits=limit, **options
        )
        self.gamma = self.tracker.engine.gamma
        self.one, self.dt, self.names = len(s.tips) == 1, s.dt, robot.joint_names
        self.rate = np.zeros(robot.n)

    def lock(self, joint):
        self.tracker.change_limits(speed={self.names[joint]: 0.0})

    def step(self, target, measured):
        target = target[0] if self.one else target
        made = self.tracker.update(target, self.dt) if measured is None else self.tracker.update(
            target, self.dt, q=measured
        )  # fmt: skip
        self.rate = made.rate
        return made.q

    def loop(self, T):
        """Seconds a step in the compiled loop, over all targets at once, as `ik.track` takes a path."""
        from ik_toolkit.servo.workspace import new_record, samples_from

        N, tracker = len(T), self.tracker
        V = np.zeros((N, 6 * T.shape[1]))
        for k, f in np.ndindex(N - 1, T.shape[1]):
            V[k + 1, 6 * f : 6 * f + 6] = twist(T[k, f], T[k + 1, f]) / self.dt
        samples, out = samples_from(T, V, np.zeros_like(V)), new_record(N, len(tracker.q), V.shape[1])
        self.step(T[0], None)  # what is bound and compiled at the first step
        began = perf_counter()
        taken = tracker.stepper.run(samples, self.dt, out)
        return (perf_counter() - began) / taken


ADAPTERS = {"ours": Ours, "dls": Damped, "jparse": Parse, "rtb": Toolbox, "pink": Pink, "mink": Mink}


# ---------------------------------------------------------------------------------------------------------- helpers
def load(ik, s):
    """The robot of a stream: one tip, or several."""
    return ik.Robot.load(s.robot, tip=s.tips[0]) if len(s.tips) == 1 else ik.Tree.load(s.robot, tips=list(s.tips))


def around(ik, robot, s):
    """The robot's collision model with the stream's boxes."""
    model = ik.CollisionModel(robot)
    for size, pose in s.obstacles:
        model.add_box(size, np.array(pose))
    return model


def one_tip(s):
    """Refuse a tree."""
    if len(s.tips) > 1:
        raise ValueError("several tips are not known here")


def damped(J, e, damping):
    """Rate of the damped pseudo-inverse."""
    return J.T @ np.linalg.solve(J @ J.T + damping**2 * np.eye(len(J)), e)


def twist(T, goal):
    """From pose T to goal (4, 4): distance and rotation vector (6,), base axes."""
    R = goal[:3, :3] @ T[:3, :3].T
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = np.sqrt(axis @ axis), 0.5 * (np.trace(R) - 1.0)
    if sine > 1e-9:
        axis = axis * (np.arctan2(sine, cosine) / sine)
    return np.concatenate([goal[:3, 3] - T[:3, 3], axis])


def follow(stepper, s, T):
    """Run a stream in virtual time: commands, rates and seconds a step.

    The joints follow the command `delay` samples late; a stream that says so hands back where they are, with noise. Should a
    step fail, the last command stays, as it would in a control loop.
    """
    rng = np.random.default_rng(s.seed)
    n, steps = len(s.q0), len(T)
    Q, R, seconds, failed = np.empty((steps + 1, n)), np.zeros((steps + 1, n)), np.empty(steps), 0
    Q[0], words = s.q0, ""
    noise = s.noise * rng.standard_normal((steps, n))
    for k in range(steps):
        if k == s.lock_at:
            stepper.lock(s.lock_joint)
        measured = Q[max(k - s.delay, 0)] + noise[k] if s.measured else None
        began = perf_counter()
        try:
            q = stepper.step(T[k], measured)
        except Exception as error:
            failed += 1
            words = words or f"step {k}: {type(error).__name__}: {error}"[:200]
            q = Q[k]
            stepper.rate = np.zeros(n)
        seconds[k] = perf_counter() - began
        Q[k + 1], R[k + 1] = q, stepper.rate
    return Q, R, seconds, failed, words


def run(message):
    """Follow the stream of a message; `input` and `output` name the files."""
    s = SimpleNamespace(**message)
    with np.load(s.input) as data:
        for name in data.files:
            setattr(s, name, data[name])
    stepper = ADAPTERS[s.adapter](s)
    if s.do == "loop":
        return {"seconds": stepper.loop(s.targets)}
    Q, R, seconds, failed, words = follow(stepper, s, s.targets)
    np.savez(s.output, Q=Q, R=R, seconds=seconds)
    return {"gamma": float(stepper.gamma), "failed": failed + stepper.relaxed, "words": words}


def main():
    """Serve until stdin ends. What a library prints goes to stderr."""
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    for line in sys.stdin:
        try:
            reply = {"ok": True, **run(json.loads(line))}
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            traceback.print_exc()
            reply = {"ok": False, "error": f"{type(error).__name__}: {error}"[:300]}
        replies.write(json.dumps(reply) + "\n")


if __name__ == "__main__":
    main()
