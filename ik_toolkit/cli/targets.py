"""`ik solve ROBOT --targets FILE`: many targets from a CSV or NPZ file, their solutions to a CSV, NPZ or Parquet file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any, NoReturn

import typer

from ..errors import InvalidOption, MissingExtra
from ..robot.pose_files import Convention, read_poses
from ..solvers.batch.result import BatchCheckFailed, BatchInterrupted, BatchResult
from ..solvers.batch.solve_batch import solve_batch, solve_parts
from .output import facts, notice, progress, show, write_json
from .solutions import OUTPUTS, Solutions
from .streams import uninterrupted


@contextmanager
def _cluster(address: str | None) -> Iterator[Any]:
    """Executor of a running Dask scheduler; Dask repeats lost tasks."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise MissingExtra("distributed", "cluster") from None
    try:
        client = Client(address, timeout=5)
    except (OSError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InvalidOption(f"no Dask scheduler answers at '{address}': {said}") from None
    with client:
        yield client.get_executor(retries=3)


class _Tally:
    """Totals over the parts of a batch."""

    def __init__(self) -> None:
        self.done, self.solver = 0, ""
        self.statuses: dict[str, int] = {}

    def add(self, part: BatchResult) -> None:
        for status, number in part.counts().items():
            self.statuses[status] = self.statuses.get(status, 0) + number
        self.done, self.solver = self.done + len(part), part.solver


def _solve_into(output: Path, arm: Any, targets: Any, method: Any, asked: dict[str, Any], show_done: Any) -> _Tally:
    """Solve and write all targets; parts as they come where the format takes parts."""
    tally = _Tally()
    parts: Iterator[BatchResult] = iter(())
    many, interrupted = None, None
    try:
        if output.suffix.lower() == ".npz":
            many = solve_batch(arm, targets, method, progress=show_done, **asked)
        else:
            parts = solve_parts(arm, targets, method, **asked)
    except BatchInterrupted as stop:
        many, interrupted = stop.result, stop
    except BatchCheckFailed as failure:
        _refuse(failure, Solutions(output, arm.joint_names))
    with Solutions(output, arm.joint_names) as file:  # opened only once the options have been accepted
        try:
            for part in parts if many is None else iter([many]):
                with uninterrupted():
                    file.add(part)
                    tally.add(part)
                show_done(tally.done)
        except BatchCheckFailed as failure:
            _refuse(failure, file)
        if interrupted is not None:
            raise interrupted
    return tally


def _refuse(failure: BatchCheckFailed, file: Solutions) -> NoReturn:
    """Report why a batch failed and where its answers are; exit code 1."""
    file.add(failure.result)
    failed = file.fail()
    notice(f"ik: {failure}")
    notice(f"the answers, all of them in doubt, are in {failed}")
    raise typer.Exit(1)


def solve_file(
    arm: Any,
    path: Path,
    output: Path | None,
    method: Any,
    start: Any,
    options: dict[str, Any],
    *,
    threads: int | None,
    cluster: str | None,
    deg: bool,
    as_json: bool,
) -> None:
    """Solve all targets of a file and write their solutions; exit code 1 when any is not solved.

    What is finished when Ctrl-C or SIGTERM comes is kept as NAME.partial. When Pinocchio does not confirm an answer, what there
    is goes to NAME.failed, and the exit code is 1.
    """
    if output is None or output.suffix.lower() not in OUTPUTS:
        raise InvalidOption(f"--targets needs -o FILE for the solutions, which ends in {', '.join(OUTPUTS)}")
    count, blocks = read_poses(path, "targets", given=Convention(deg=deg), tips=arm.tips if arm.by_tip else ())
    targets: Any = (poses for _, poses in blocks) if path.suffix.lower() == ".csv" else next(blocks).poses
    began = perf_counter()
    with _cluster(cluster) as executor, progress("solving", count) as show_done:
        asked: dict[str, Any] = {"q0": start, "threads": threads, "executor": executor, **options}
        tally = _solve_into(output, arm, targets, method, asked, show_done)
    done = tally.done
    elapsed = perf_counter() - began
    notice(f"wrote {output}")
    solved = tally.statuses.get("CONVERGED", 0)
    payload = {"robot": arm.name, "solver": tally.solver, "targets": done, "solved": solved, "statuses": tally.statuses}
    payload |= {"tips": arm.tips} if arm.by_tip else {}
    payload |= {"joint_names": arm.joint_names, "elapsed": elapsed, "output": output, "seed": options["seed"]}
    write_json(payload, as_json)
    if not as_json:
        others = ", ".join(f"{number} {status}" for status, number in tally.statuses.items() if status != "CONVERGED")
        rate = f"{elapsed:.3g} s, {done / elapsed:.3g} targets/s with reading and writing"
        facing = {
            "solved": f"{solved} of {done}",
            "not solved": others or None,
            "solver": tally.solver or None,
            "time": rate,
        }
        show(facts(facing))
    if solved < done:
        raise typer.Exit(1)
