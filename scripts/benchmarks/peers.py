"""The solvers that solve.py compares, each in its own virtual environment and its own process."""

import json
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

WORKER = Path(__file__).with_name("worker.py")


@dataclass(frozen=True)
class Peer:
    """A solver to compare: name, adapter in worker.py, packages to install (none: this environment), description.

    share: part of the targets it gets (slow ones get only the first few); six: for arms with six joints only; home: the peer
    whose environment it uses, if not its own.
    """

    name: str
    adapter: str
    packages: tuple[str, ...]
    about: str
    share: float = 1.0
    six: bool = False
    home: str = ""


PEERS = (
    Peer("ik", "ik_bound", (), "bound solver `lm`, no start given (near starts: given)"),
    Peer("ik_q0", "ik_given", (), "the same, with the start that the others get"),
    Peer("ik.solve", "ik_solve", (), "`ik.solve`, everything on: checks of input, Pinocchio's check of the answer"),
    Peer("ik_all", "ik_all", (), "every solution within the limits, certified (`Solver.all`)", six=True),
    Peer("rtb", "rtb", ("roboticstoolbox-python",), "Robotics Toolbox, `ik_LM(k=0.1)`, C++"),
    Peer(
        "rtb_free",
        "rtb_free",
        ("roboticstoolbox-python",),
        "the same with `joint_limits=False` and its own starts, as in its authors' notebook; limits count here, too",
        home="rtb",
    ),
    Peer(
        "eaik",
        "eaik",
        ("EAIK",),
        "analytic, all solutions, knows no limits and no start, C++ by its Python binding",
        six=True,
    ),
    Peer("cartan", "cartan", ("cartan-bindings",), "`solve_ik_speed`, projected LM, C++"),
    Peer("optik", "optik", ("optik-py", "numpy"), "SLSQP, one thread, Rust"),
    Peer("dynibo", "dynibo", ("dynibo", "numpy"), "damped least squares, restarts added by the benchmark, Rust"),
    Peer("pytracik", "pytracik", ("pytracik",), "TRAC-IK, its two threads, C++", share=0.5),
    Peer(
        "ssik", "ssik", ("ssik[urdf]",), "analytic, all solutions, `from_urdf` (no generated code)", share=0.1, six=True
    ),
    Peer(
        "ssik_built",
        "ssik_built",
        ("ssik[urdf]",),
        "one solution of the code that `ssik build` writes, `native=True`, `enumerate_windings=False`",
        six=True,
        home="ssik",
    ),
    Peer("pink", "pink", ("pin-pink", "qpsolvers[quadprog]"), "QP steps, 50 an attempt, restarts added", share=0.1),
    Peer("mink", "mink", ("mink", "qpsolvers[daqp]"), "QP steps, 50 an attempt, restarts added", share=0.1),
    Peer("ikpy", "ikpy", ("ikpy",), "SciPy least squares, restarts added", share=0.03),
)
BY_NAME = {peer.name: peer for peer in PEERS}
DISTRIBUTIONS = {"rtb": "roboticstoolbox-python", "eaik": "eaik", "cartan": "cartan-bindings", "optik": "optik-py"}
DISTRIBUTIONS |= {"pink": "pin-pink"}


def python_of(peer: Peer, venvs: Path | None) -> tuple[Path, str]:
    """Python of the peer's environment, which is created if necessary, and the peer's version."""
    if not peer.packages:
        return Path(sys.executable), ""
    assert venvs is not None
    folder = venvs / (peer.home or peer.name)
    python = folder / "bin" / "python"
    done = folder / "installed"
    if not python.exists():
        print(f"installing {peer.name} ({' '.join(peer.packages)}) ...", file=sys.stderr)
        venv.create(folder, with_pip=True)
    if not done.exists():
        command = [str(python), "-m", "pip", "install", "-q", *peer.packages]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode:
            raise RuntimeError(f"pip failed: {run.stderr.strip().splitlines()[-1]}")
        done.touch()
    name = DISTRIBUTIONS.get(folder.name, folder.name)
    code = f"import importlib.metadata as m; print(m.version('{name}'))"
    run = subprocess.run([str(python), "-c", code], capture_output=True, text=True)
    return python, run.stdout.strip()


class Process:
    """A running worker."""

    def __init__(self, peer: Peer, venvs: Path | None, folder: Path, worker: Path = WORKER) -> None:
        """Start the process. Its output goes to a log file in `folder`."""
        self.peer = peer
        self.folder = folder
        python, self.version = python_of(peer, venvs)
        with (folder / f"{peer.name}.log").open("w") as log:
            self._process = subprocess.Popen(
                [str(python), str(worker)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
            )

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        """Answer to one message. Raises RuntimeError with the worker's message."""
        assert self._process.stdin and self._process.stdout
        try:
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()
            reply = self._process.stdout.readline()
        except BrokenPipeError:
            reply = ""
        if not reply:
            log = (self.folder / f"{self.peer.name}.log").read_text(encoding="utf-8").strip().splitlines()
            raise RuntimeError(f"the process ended with code {self._process.wait()}: {log[-1] if log else ''}")
        answer = json.loads(reply)
        if not answer["ok"]:
            raise RuntimeError(answer["error"])
        return answer

    def build(self, description: dict[str, Any]) -> float:
        """Build the solver for a robot and tolerances; returns the seconds taken. Raises RuntimeError with the peer's message."""
        return self.ask({"do": "build", "adapter": self.peer.adapter, **description})["seconds"]

    def solve(self, T: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Seconds (2, N), wall and processor, and answers (N, k, n), NaN where there is none."""
        source, destination = self.folder / f"{self.peer.name}_in.npz", self.folder / f"{self.peer.name}_out.npz"
        np.savez(source, T=T, Q=Q)
        self.ask({"do": "solve", "input": str(source), "output": str(destination)})
        with np.load(destination) as data:
            return np.array([data["seconds"], data["processor"]]), data["answers"]

    def close(self) -> None:
        """End the process."""
        if self._process.stdin:
            self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
