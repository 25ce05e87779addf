"""Cost of the building blocks (forward kinematics, Jacobian, one iteration): the compiled kernel and Pinocchio.

python scripts/benchmarks/kernel.py              (two versions against each other: against.py)
"""

import common

common.one_thread()

from collections.abc import Callable  # noqa: E402
from time import perf_counter  # noqa: E402

import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402

import ik_toolkit as ik  # noqa: E402
from ik_toolkit.kernel.chain import forward_kinematics  # noqa: E402
from ik_toolkit.kernel.counted_error import KIND  # noqa: E402
from ik_toolkit.kernel.records import SIZE  # noqa: E402
from ik_toolkit.kernel.simd_search import lanes  # noqa: E402

UNREACHABLE = "`ik.solve` from Python: a target proven out of reach"


def works(name: str, count: int, rng: np.random.Generator) -> dict[str, tuple[Callable[[], object], float]]:
    """Row -> (function to time, number of repetitions in it)."""
    robot = ik.Robot.load(name)
    robot = ik.Robot.load(common.serial_urdf(robot), base=robot.base, tip=robot.tip)
    Q, T = common.random_targets(robot, count, rng)
    chain, model, data = robot.chain, robot.model, robot.model.createData()
    poses, J, none = np.empty((count, 4, 4)), np.empty((count, 6, robot.n)), np.empty((0, 6, robot.n))
    frame = model.getFrameId(robot.tip, pin.FrameType.BODY)
    solver = ik.Solver(robot)
    out = np.empty((count, SIZE.answer + robot.n))
    plan = ik.Solver(robot).plan
    arrays, orders = plan.arrays((KIND.pose,), plan.home), plan.orders((KIND.pose,), False)
    targets = list(T)

    def solve() -> None:
        plan.run(T, (KIND.pose,), plan.home, False, out)

    solve()
    iterations = out[:, 1].sum()
    side = np.empty_like(out)

    def side_by_side() -> None:  # what a batch runs; the few targets left over are not solved here
        lanes()(*arrays, T, plan.home, side, orders)

    side_by_side()

    def pinocchio_fk() -> None:
        for q in Q:
            pin.forwardKinematics(model, data, q)
            pin.updateFramePlacement(model, data, frame)

    def pinocchio_jacobian() -> None:
        for q in Q:
            pin.computeJointJacobians(model, data, q)
            pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)

    def pinocchio_step() -> None:  # what a loop written in Python does each iteration, before it solves for dq
        goal = pin.SE3(T[0])
        for q in Q:
            pin.computeJointJacobians(model, data, q)
            error = pin.log6(pin.updateFramePlacement(model, data, frame).actInv(goal)).vector
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            pin.integrate(model, q, J.T @ np.linalg.solve(J @ J.T + 1e-9 * np.eye(6), error))

    far = T.copy()
    far[:, :3, 3] *= (2.0 * robot.reach / np.linalg.norm(T[:, :3, 3], axis=1))[:, None]

    def python_solve() -> None:
        for target in targets:
            solver(target)

    def unreachable() -> None:
        for target in far:
            assert ik.solve(robot, target).status == ik.Status.UNREACHABLE

    return {
        "kernel: FK": (lambda: forward_kinematics(chain.rows, chain.ends, Q, chain.unit, poses, none), count),
        "kernel: FK + Jacobian": (lambda: forward_kinematics(chain.rows, chain.ends, Q, chain.unit, poses, J), count),
        "kernel: one iteration of `lm` (all in)": (solve, iterations),
        "kernel: one solve": (solve, count),
        "kernel: one solve, eight side by side": (side_by_side, count),
        "bound solver from Python: one solve": (python_solve, count),
        UNREACHABLE: (unreachable, count),
        "Pinocchio from Python: FK": (pinocchio_fk, count),
        "Pinocchio from Python: FK + Jacobian": (pinocchio_jacobian, count),
        "Pinocchio from Python: one damped iteration": (pinocchio_step, count),
    }


def main() -> None:
    parser = common.parser(__doc__, "benchmark_kernel.json")
    parser.add_argument("--robots", nargs="+", default=common.ROBOTS)
    parser.add_argument("--count", type=int, default=2000, help="configurations per run")
    parser.add_argument("--runs", type=int, default=15, help="runs; the median is reported")
    given = parser.parse_args()
    before = common.load_average()
    medians: dict[str, dict[str, float]] = {}
    for name in given.robots:
        rows = works(name, given.count, np.random.default_rng(given.seed))
        times: dict[str, list[float]] = {key: [] for key in rows}
        for work, _ in rows.values():
            work()
        for _ in range(given.runs):
            for key, (work, count) in rows.items():
                started = perf_counter()
                work()
                times[key].append(1e9 * (perf_counter() - started) / count)
        for key, values in times.items():
            medians.setdefault(key, {})[name] = float(np.median(values))
    rows = [[key, *(f"{values[name]:,.0f}" for name in given.robots)] for key, values in medians.items()]
    payload = {"machine": common.machine(), "load_average": [before, common.load_average()], "median_ns": medians}
    common.write(
        given.output, payload, "Nanoseconds, median of interleaved runs:", common.table(["", *given.robots], rows)
    )


if __name__ == "__main__":
    main()
