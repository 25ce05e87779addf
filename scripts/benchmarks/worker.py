"""One solver in its own process: builds it, solves blocks of targets and times every call.

Started by solve.py with the Python of the solver's own environment, where ik_toolkit need not be installed; it needs only numpy.
Protocol: one JSON object per line on stdin and stdout. {"do": "build", ...} builds the solver for a robot and a tolerance;
{"do": "solve", "input": npz, "output": npz} solves targets T (N, 4, 4) from starts Q (N, n) and writes seconds (N,), wall
and processor (all threads), and answers (N, k, n), NaN where there is none.

An adapter takes the robot's description and returns `call(T, q0)`, which is timed, and `read(answer)`, which is not timed and
converts the answer to a list of q.
"""

import json
import os
import sys
from time import perf_counter, process_time
from types import SimpleNamespace

import numpy as np

CAP = 0.05  # [s] time limit for restarts added here, and for peers with a time budget
EDGE = 1e-6  # [rad or m] tolerated excess over a limit (TRAC-IK clamps to within 5e-9)
WARM = 5  # untimed solves at the start of a block: caches are cold after the other processes' turns
STEPS = 50  # steps per attempt, for peers that offer only single steps


def one(q):
    """An answer that is a q or None."""
    return [] if q is None else [q]


def with_q(call):
    """Include the time of reading q from the answer."""

    def timed(T, q0):
        answer = call(T, q0)
        answer.q  # noqa: B018
        return answer

    return timed


def successful(answer):
    """An answer with q and success."""
    return [answer.q] if answer.success else []


# ------------------------------------------------------------------------------------------------------ ik_toolkit
def ik_bound(s, solver="lm", given=False):
    import ik_toolkit as ik

    robot = ik.Robot.load(s.urdf, tip=s.tip, base=s.base)
    bound = ik.Solver(robot, solver, position_tolerance=s.tol_p, orientation_tolerance=s.tol_r)
    if given or s.near:
        return with_q(bound), successful
    return with_q(lambda T, q0: bound(T)), successful


def ik_given(s):
    return ik_bound(s, given=True)


def ik_all(s):
    import ik_toolkit as ik

    robot = ik.Robot.load(s.urdf, tip=s.tip, base=s.base)
    bound = ik.Solver(robot, position_tolerance=s.tol_p, orientation_tolerance=s.tol_r)
    return lambda T, q0: bound.all(T).q, list


def ik_solve(s):
    import ik_toolkit as ik

    robot = ik.Robot.load(s.urdf, tip=s.tip, base=s.base)
    tolerance = {"position_tolerance": s.tol_p, "orientation_tolerance": s.tol_r}
    if s.near:
        return with_q(lambda T, q0: ik.solve(robot, T, q0=q0, **tolerance)), successful
    return with_q(lambda T, q0: ik.solve(robot, T, **tolerance)), successful


# ------------------------------------------------------------------------------------------------ compiled peers
def rtb(s):
    import roboticstoolbox

    ets = roboticstoolbox.Robot.URDF(s.path).ets()
    tol = 0.5 * s.tol_p**2  # its residual is half the square of the whole error
    return with_q(lambda T, q0: ets.ik_LM(T, q0=q0, tol=tol, k=0.1)), successful


def rtb_free(s, tol=None, **limits):
    """As in its own notebook: joint limits ignored, random starts."""
    import roboticstoolbox

    ets = roboticstoolbox.Robot.URDF(s.path).ets()
    tol = tol or 0.5 * s.tol_p**2
    return with_q(lambda T, q0: ets.ik_LM(T, tol=tol, k=0.1, joint_limits=False, **limits)), successful


def rtb_published(s):
    return rtb_free(s, tol=1e-6, ilimit=30, slimit=100)


def eaik(s):
    from eaik.IK_HP import HPRobot

    robot = HPRobot(s.H, s.P)
    if not robot.hasKnownDecomposition():
        raise ValueError("no known decomposition of this arm")
    tip = np.eye(4)
    tip[:3, :3] = s.R_tip.T
    return lambda T, q0: robot.IK(T @ tip).Q, list


def cartan(s):
    import cartan

    chain = cartan.load_urdf(s.path).chain
    most = 100_000
    config = cartan.IkConfig(
        position_tol=s.tol_p, orientation_tol=s.tol_r, max_total_work_units=most, max_total_iterations=most
    )
    pose, solve = cartan.SE3.from_matrix, cartan.solve_ik_speed
    return with_q(lambda T, q0: solve(chain, pose(T), q0, config)), lambda r: one(r.q if r.converged else None)


def optik(s):
    import optik

    robot = optik.Robot.from_urdf_file(s.path, s.base, s.tip)
    robot.set_parallelism(1)
    config = optik.SolverConfig(solution_mode="speed", max_time=CAP, tol_f=min(s.tol_p, s.tol_r) ** 2)
    # It inverts the rotation of a fixed first joint; targets are transformed accordingly, so that only its solver is judged.
    moved = np.array(robot.fk(np.zeros(len(s.lower)))) @ np.linalg.inv(s.T_zero)
    if np.allclose(moved, np.eye(4), atol=1e-9):
        return lambda T, q0: robot.ik(config, T, q0), lambda r: one(r and r[0])
    return lambda T, q0: robot.ik(config, moved @ T, q0), lambda r: one(r and r[0])


def pytracik(s, timeout=CAP, share=0.57):
    from trac_ik import TracIK

    robot = TracIK(s.base, s.tip, s.path, timeout=timeout, epsilon=share * s.tol_p)  # an epsilon for each axis
    return lambda T, q0: robot.ik(T[:3, 3], T[:3, :3], q0), one


def pytracik_published(s):
    return pytracik(s, timeout=s.timeout, share=1.0)


def dynibo(s):
    import dynibo

    robot = dynibo.Robot.from_urdf(s.path)
    target = robot.link_id(s.tip)
    options = dynibo.IkOptions(translation_tolerance=s.tol_p, rotation_tolerance=s.tol_r)

    def attempt(T, q0):
        desired = dynibo.Pose(translation=T[:3, 3], rotation_xyzw=quaternion_xyzw(T))
        return robot.inverse_kinematics(q0, target, desired, options)

    return restarted(s, attempt), one


def ssik(s):
    from ssik import Manipulator

    arm = Manipulator.from_urdf(s.path, base=s.base, ee=s.tip)
    arm.prepare()
    return lambda T, q0: [x.q for x in arm.solve(T)], list


def ssik_built(s):
    """One answer from the code that `ssik build` generates for the robot, by its native backend."""
    import importlib.util
    import subprocess
    from pathlib import Path

    file = Path(s.path).with_name("built_ik.py")
    command = [str(Path(sys.executable).with_name("ssik")), "build", s.path, "--base", s.base, "--ee", s.tip]
    subprocess.run([*command, "--no-validate", "--out", str(file)], check=True, capture_output=True)
    spec = importlib.util.spec_from_file_location("built_ik", file)
    arm = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(arm)
    options = {"max_solutions": 1, "enumerate_windings": False, "native": True}
    return lambda T, q0: [x.q for x in arm.solve(T, **options)], list


# ------------------------------------------------------------------------------------------ differential and Python
def pink(s):
    import pink as library
    import pinocchio as pin

    model = pin.buildModelFromUrdf(s.path)
    configuration = library.Configuration(model, model.createData(), pin.neutral(model))
    task = library.FrameTask(s.tip, position_cost=1.0, orientation_cost=1.0)

    def attempt(T, q0):
        configuration.update(q0)
        task.set_target(pin.SE3(T[:3, :3], T[:3, 3]))
        for _ in range(STEPS):
            error = task.compute_error(configuration)
            if norm(error[:3]) < s.tol_p and norm(error[3:]) < s.tol_r:
                return configuration.q.copy()
            velocity = library.solve_ik(
                configuration, [task], 1.0, solver="quadprog", damping=1e-12, safety_break=False
            )
            configuration.integrate_inplace(velocity, 1.0)
        return None

    return restarted(s, attempt), one


def mink(s):
    import mink as library
    import mujoco

    keep = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco></robot>'
    model = mujoco.MjModel.from_xml_string(s.urdf.replace("</robot>", keep))
    configuration = library.Configuration(model)
    task = library.FrameTask(s.tip, "body", position_cost=1.0, orientation_cost=1.0)
    limits = [library.ConfigurationLimit(model)]

    def attempt(T, q0):
        configuration.update(q0)
        task.set_target(library.SE3.from_matrix(T))
        for _ in range(STEPS):
            error = task.compute_error(configuration)
            if norm(error[:3]) < s.tol_p and norm(error[3:]) < s.tol_r:
                return configuration.q.copy()
            velocity = library.solve_ik(configuration, [task], 1.0, solver="daqp", damping=1e-12, limits=limits)
            configuration.integrate_inplace(velocity, 1.0)
        return None

    return restarted(s, attempt), one


def ikpy(s):
    from ikpy.chain import Chain

    chain = Chain.from_urdf_file(s.path, base_elements=[s.base])
    moving = [link.joint_type in ("revolute", "prismatic") for link in chain.links]
    chain.active_links_mask = np.array(moving)

    def attempt(T, q0):
        full = np.zeros(len(moving))
        full[moving] = q0
        q = chain.inverse_kinematics_frame(T, initial_position=full, orientation_mode="all")[moving]
        full[moving] = q
        reached = chain.forward_kinematics(full)
        if norm(reached[:3, 3] - T[:3, 3]) < s.tol_p and norm(reached[:3, :3] - T[:3, :3]) < 1.4 * s.tol_r:
            return q
        return None

    return restarted(s, attempt), one


# ---------------------------------------------------------------------------------------------------------- helpers
def norm(v):
    """Euclidean length; of a matrix, of its entries."""
    return float(np.sqrt((v * v).sum()))


def quaternion_xyzw(T):
    """Quaternion of a rotation, by its largest component."""
    xx, yy, zz = T[0, 0], T[1, 1], T[2, 2]
    squares = (1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz)
    k = squares.index(max(squares))
    a, b, c = T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]
    d, e, f = T[1, 0] + T[0, 1], T[0, 2] + T[2, 0], T[2, 1] + T[1, 2]
    rows = ((squares[0], d, e, a), (d, squares[1], f, b), (e, f, squares[2], c), (a, b, c, squares[3]))
    half = 0.5 / squares[k] ** 0.5
    return tuple(half * x for x in rows[k])


def wrapped(q, lower, upper):
    """Move revolute joints beyond a limit by full turns, back inside if possible."""
    turn = 2 * np.pi
    q = q - turn * np.ceil(np.maximum(q - upper - EDGE, 0.0) / turn)
    return q + turn * np.ceil(np.maximum(lower - q - EDGE, 0.0) / turn)


def restarted(s, attempt):
    """Restart an attempt from random configurations until an answer is inside the limits or time runs out."""
    rng = np.random.default_rng(1)

    def call(T, q0):
        end = perf_counter() + CAP
        while True:
            try:
                q = attempt(T, q0)
            except Exception:  # for example an infeasible QP: a failed attempt
                q = None
            if q is not None:
                q = wrapped(q, s.lower, s.upper)
                if (q >= s.lower - EDGE).all() and (q <= s.upper + EDGE).all():
                    return q
            if perf_counter() > end:
                return None
            q0 = s.lower + (s.upper - s.lower) * rng.random(len(q0))

    return call


def build(message):
    """Build the solver of a message: robot description with arrays, and the adapter's two functions."""
    s = SimpleNamespace(**message)
    for name in ("lower", "upper", "H", "P", "R_tip", "T_zero"):
        setattr(s, name, np.array(getattr(s, name), dtype=float))
    call, read = globals()[s.adapter](s)
    return s, call, read


def solve(call, read, n, source, destination):
    """Solve one block."""
    with np.load(source) as data:
        targets, starts = list(data["T"]), list(data["Q"])
    seconds, processor = np.empty(len(targets)), np.empty(len(targets))
    answers = []
    for T, q0 in list(zip(targets, starts, strict=True))[:WARM]:
        try:
            call(T, q0)
        except Exception:  # it is counted when it is timed
            pass
    for k, (T, q0) in enumerate(zip(targets, starts, strict=True)):
        busy = process_time()
        started = perf_counter()
        try:
            answer = call(T, q0)
        except Exception as error:
            answer, failed = None, error
            print(f"target {k}: {type(error).__name__}: {error}", file=sys.stderr)
        else:
            failed = None
        seconds[k] = perf_counter() - started
        processor[k] = process_time() - busy
        answers.append([] if failed else [np.asarray(q, dtype=float) for q in read(answer)])
    table = np.full((len(targets), max(1, *map(len, answers)), n), np.nan)
    for k, solutions in enumerate(answers):
        for i, q in enumerate(solutions):
            table[k, i] = q
    np.savez(destination, seconds=seconds, processor=processor, answers=table)


def main():
    """Serve until stdin ends. Library output goes to stderr."""
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    state = None
    for line in sys.stdin:
        message = json.loads(line)
        try:
            if message["do"] == "build":
                started = perf_counter()
                state = build(message)
                reply = {"ok": True, "seconds": perf_counter() - started}
            else:
                s, call, read = state
                solve(call, read, len(s.lower), message["input"], message["output"])
                reply = {"ok": True}
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            reply = {"ok": False, "error": f"{type(error).__name__}: {error}"[:300]}
        replies.write(json.dumps(reply) + "\n")


if __name__ == "__main__":
    main()
