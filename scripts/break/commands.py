"""Random command lines: every command with odd robots, options, values, files and streams.

python scripts/break/commands.py [--seed 0] [--count 2000]

Each runs in a process forked after the imports, with limits on memory and time (then SIGTERM, as a user would send). A failure is
a crash, a traceback, exit code 70, a control character on the terminal, an existing output file lost or truncated, or a process
that does not end. Exit code 1 if any failed; the failing command lines are printed.
"""

import argparse
import contextlib
import io
import os
import random
import re
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import typer

import ik_toolkit as ik
from ik_toolkit.cli import application, main
from ik_toolkit.errors import CONTROLS

ENDS = {0, 1, 2, 3, 130, 143}  # legitimate exit codes
SECONDS, GRACE = 20.0, 30.0  # until SIGTERM, and from then until SIGKILL, which is a failure
MEMORY = 3 * 2**30  # bytes a command may use in addition to those already in use
OLD = b"what was here before\n"
SLOW = {"panel", "reproduce"}  # these serve for ever or take minutes: run only with mistakes
ROBOTS = ("planar_2r", "planar_3r", "hydrolek_7w", "panda", "inspection_7dof", "brokk_hydrolek", "cartesian_pp")
SMALL = {  # so that most command lines finish
    "bench": ["-n", "3", "--solvers", "lm"],
    "tune": ["--generations", "1", "--targets", "10", "--held-out", "1", "--population", "4"],
    "workspace": ["-n", "20"],
    "track": ["--duration", "0.1"],
    "view": ["--html", "out.html", "--no-open"],
}
NUMBERS = (
    "0 -0 1 -1 2 3 7 0.5 -0.3 1e-3 1e-300 5e-324 1e300 1e308 -1e308 1e999 nan -nan inf -inf 1_000 0x10 1e 2147483648 "
    "9223372036854775808 -9223372036854775809 3.999 90 180"
).split()
WORDS = (
    "", " ", "-", "--", "=", ",", ":", "None", "true", "[1,2", '{"a":1}', "lm", "LM", "dls", "pid", "state-space", "newton",
    "ccd", "planar-2r", "inspection", "eaik", "auto", "burrell-2016", "base", "tip", "tool", "tool0", "panda_hand_tcp",
    "constant", "circle", "eight", "line", "cma", "pso", "joints", "volume", "mid-range", "manipulability", "x" * 5000,
    "é腕", "\x1b]0;owned\x07", "\x9b31m", "\u202e\u2066", "٣", "a\nb", "../../etc/passwd", "/", ".", "sphere:1,1,1,0.2",
    "box:0,0,0,1,1,1", "sphere:nan,0,0,1", "gain=0.5", "damping=1e9", "damping=nan", "kp=", "=1", "j=1=2", "azimuth_yaw=0.1",
    "left_tip:1.2,0.4,1.0", "tool:1,2,3", "tool:1,2,3,0,0,0,1", "9" * 400,
)  # fmt: skip


def npz(**arrays: object) -> bytes:
    data = io.BytesIO()
    np.savez(data, **arrays)  # pyright: ignore[reportArgumentType]
    return data.getvalue()


def hostile_files(folder: Path, rng: random.Random) -> list[str]:
    """Write targets, robots, tables and garbage of every kind; returns their names."""
    good = npz(targets=np.tile([1.0, 0.5, 0.0], (50, 1)))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("targets.npy", zipfile.ZipFile(io.BytesIO(good)).read("targets.npy"))
    files: dict[str, bytes] = {
        "good.npz": good,
        "good.csv": b"x,y,z\n1,0.5,0\n1,1,0\n",
        "quat.csv": b"x,y,z,qx,qy,qz,qw\n1,0.5,0,0,0,0,1\n1,1,0,0,0,0,2\n",
        "rpy.csv": b"x,y,z,roll,pitch,yaw\n1,0.5,0,0,0,0\n1,1,0,90,0,1e9\n",
        "nan.npz": npz(targets=np.full((9, 3), np.nan)),
        "scalar.npz": npz(targets=np.float64(1)),
        "empty.npz": npz(targets=np.empty((0, 3))),
        "words.npz": npz(targets=np.array([["a", "b", "c"]])),
        "complex.npz": npz(targets=np.ones((2, 4, 4), complex)),
        "objects.npz": npz(targets=np.array([{}], dtype=object)),
        "evil.npz": npz(**{"\x1b[2J\u202e": np.ones(3)}),
        "lzma.npz": packed.getvalue(),
        "quote.csv": b'x,y,z\n1,"1,0\n1,1,0\n',
        "nul.csv": b"x,y,z\n1,\x00,0\n",
        "latin.csv": b"x,y,z\n1,\xff,0\n",
        "evil.csv": b"\x1b]0;owned\x07,\xc2\x9b,\xe2\x80\xae\n1,1,0\n",
        "cell.csv": b"x,y,z\n1,\x1b[2J,0\n",
        "wide.csv": b"x,y,z\n" + b"1" * 200_000 + b",1,0\n",
        "path.csv": b"t,x,y,z\n0,1,1,0\n0.1,1.01,1,0\n0.2,1.02,1,0\n",
        "rubbish.urdf": b"<robot",
        "empty.urdf": b"",
        "none.urdf": b'<robot name="x"><link name="only"/></robot>',
        "entity.urdf": b'<!DOCTYPE a [<!ENTITY b "c">]><robot name="&b;"/>',
        "evil.urdf": (
            '<robot name="\u009b\u202e"><link name="a"/><link name="\u202eb"/><joint name="\u009bj" type="revolute"><parent '
            'link="a"/><child link="\u202eb"/><axis xyz="0 0 1"/><origin xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" '
            'velocity="1"/></joint></robot>'
        ).encode(),
        "bad.toml": b"solver = \n",
        "preset.toml": b'solver = "pid"\n[parameters]\nkp = [1, 2]\n',
        "rubbish.bin": rng.randbytes(4096),
    }
    for name, data in list(files.items()):
        if name.endswith((".npz", ".csv", ".toml", ".urdf")) and len(data) < 5000:
            cut = bytearray(data[: rng.randrange(len(data) + 1)])
            for _ in range(3):
                if cut:
                    cut[rng.randrange(len(cut))] = rng.randrange(256)
            files[f"torn-{name}"] = bytes(cut)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    (folder / "folder.csv").mkdir()
    (folder / "folder.urdf").mkdir()
    (folder / "loop.csv").symlink_to("loop.csv")
    (folder / "hard.csv").hardlink_to(folder / "good.csv")
    (folder / "soft.npz").symlink_to("good.npz")
    return [*files, "folder.csv", "folder.urdf", "loop.csv", "hard.csv", "soft.npz", "missing.csv", "missing/out.csv"]


SENSIBLE = {  # values that get a command line past its checks
    "--solver": "lm dls pinv transpose newton ccd pid state-space planar-2r inspection auto".split(),
    "--tolerance": ["1e-6", "1e-3", "1e-12"],
    "--tip": ["tool", "tip", "panda_hand_tcp", "left_tip"],
    "--base": ["base", "base_link"],
    "--param": ["damping=0.1", "gain=0.5", "kp=1"],
    "--mask": ["1,1,1,0,0,0", "1,1,1,1,1,0"],
    "--objective": ["mid-range", "manipulability"],
    "--obstacle": ["sphere:1,1,1,0.2", "box:0,0,-1,1,1,0.1"],
    "--max-iterations": ["1", "50"],
    "--restarts": ["0", "3"],
    "--seed": ["0", "7"],
    "--targets": ["1", "30"],
    "--preset": ["burrell-2016", "preset.toml", "pid=hydrolek-7w"],
    "--q": ["0.1,0.2", "0,0,0", "0.1,0.2,0,0,0,0", "0,0,0,-1,0,1,0"],
    "--q0": ["0.1,0.2", "0,0,0", "0.1,0.2,0,0,0,0", "0,0,0,-1,0,1,0"],
    "--method": ["cv", "ca", "lm", "dls", "cma", "pso"],
    "--path": ["circle", "line", "eight", "path.csv"],
    "--rate": ["50", "1000"],
    "--sample": ["joints", "volume"],
}
OUTPUTS = ("out.json", "out.csv", "out.npz", "out.toml", "out.urdf", "out.html", "out.png")


class Lines:
    """Random command lines."""

    def __init__(self, rng: random.Random, files: list[str]) -> None:
        self.rng, self.files = rng, files
        group = typer.main.get_command(application())
        self.commands = group.commands  # pyright: ignore[reportAttributeAccessIssue]

    def value(self, option: str) -> list[str]:
        """Words for an option's value, usually of the right kind."""
        rng = self.rng
        if option in SENSIBLE and rng.random() < 0.7:
            return [rng.choice(SENSIBLE[option])]
        if option in ("--output", "--html", "--plot", "--csv"):
            return [rng.choice([*OUTPUTS, *OUTPUTS, *self.files, "/dev/null", "/dev/full", ""])]
        if option == "--targets":
            return [rng.choice(self.files)]
        if (
            option in ("--xyz", "--start", "--end", "--direction", "--tip-axis", "--axis", "--rpy")
            and rng.random() < 0.7
        ):
            return [f"{rng.uniform(-2, 2):.4g}" for _ in range(3)]
        kind = rng.random()
        if kind < 0.5:
            return [rng.choice(NUMBERS) for _ in range(rng.choice((1, 1, 1, 2, 3, 4, 6, 7)))]
        return [rng.choice(WORDS if kind < 0.85 else self.files)]

    def line(self) -> list[str]:
        """One command line."""
        rng = self.rng
        name = rng.choice([*self.commands, "solve", "solve", "solve", "fk", "info", "track"])
        words = [name, *SMALL.get(name, ())]
        parameters = self.commands[name].params
        for parameter in parameters:
            if parameter.param_type_name == "argument":
                kind = rng.random()
                pool = ROBOTS if kind < 0.7 else self.files if kind < 0.85 else WORDS
                if name in SLOW:
                    pool = ("no such thing", *self.files)
                if rng.random() < 0.95:
                    words.append(rng.choice(pool))
        options = [p for p in parameters if p.param_type_name == "option" and not {"--view", "--prepare"} & {*p.opts}]
        if name == "solve" and rng.random() < 0.4:
            words += ["--xyz", *self.value("--xyz")]
        elif name == "solve":
            words += ["--targets", *self.value("--targets"), "-o", rng.choice(OUTPUTS[:3])]
            options = [p for p in options if not {"--xyz", "--plot", "--html", "--all"} & {*p.opts}] or options
        for parameter in rng.sample(options, min(len(options), rng.choice((0, 1, 1, 2, 3, 5, 8)))):
            option = max(rng.choice((parameter.opts, parameter.secondary_opts or parameter.opts)), key=len)
            words.append(option)
            if not parameter.is_flag:
                words += self.value(option)
        if rng.random() < 0.05:
            words.insert(rng.randrange(len(words) + 1), rng.choice(WORDS))
        if name in SLOW and not any(word in self.files or word == "no such thing" for word in words[1:]):
            words.append("no such thing")
        return [word for word in words if "\0" not in word]


def run(words: list[str], folder: Path, closed: tuple[int, ...]) -> tuple[int, str]:
    """Run one command in a forked process; returns its exit code (below 0: the signal that killed it) and its output."""
    said = folder / "said"
    child = os.fork()
    if child == 0:
        os.chdir(folder / "work")
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with contextlib.suppress(ValueError):
            here = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (here + MEMORY, here + MEMORY))
        stream = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        for number in (1, 2):
            os.dup2(stream, number)
        sys.stdin, sys.stdout, sys.stderr = (open(k, mode, closefd=False) for k, mode in ((0, "r"), (1, "w"), (2, "w")))
        for number in closed:
            os.close(number)
            setattr(sys, {1: "stdout", 2: "stderr"}[number], None)
        code = 99
        try:
            code = main(words)
        except BaseException:
            import traceback

            with contextlib.suppress(Exception):
                os.write(stream, traceback.format_exc().encode())
        finally:
            with contextlib.suppress(Exception):
                sys.stdout.flush()
            os._exit(code if isinstance(code, int) else 99)
    for limit, number in ((SECONDS, signal.SIGTERM), (GRACE, signal.SIGKILL)):
        end = time.monotonic() + limit
        while time.monotonic() < end:
            pid, status = os.waitpid(child, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status), said.read_text("utf-8", "replace")
            time.sleep(0.002)
        os.kill(child, number)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), said.read_text("utf-8", "replace")


def fresh(folder: Path, source: Path) -> None:
    """Create the command's working folder, with existing output files."""
    shutil.rmtree(folder / "work", ignore_errors=True)
    shutil.copytree(source, folder / "work", symlinks=True)
    os.unlink(folder / "work" / "hard.csv")
    os.link(folder / "work" / "good.csv", folder / "work" / "hard.csv")
    for name in OUTPUTS:
        (folder / "work" / name).write_bytes(OLD)


def faults(folder: Path, source: Path, code: int, said: str, words: list[str]) -> list[str]:
    """Faults in how a command ended."""
    found = []
    if code not in ENDS:
        found.append(f"exit code {code}")
    if "Traceback" in said or "a bug of ik_toolkit" in said or "Exception ignored" in said:
        found.append("traceback")
    if CONTROLS.search(said.replace("\r", "")):
        found.append(f"control character {CONTROLS.search(said)}")
    work = folder / "work"
    if re.search(r"\.part$", " ".join(path.name for path in work.iterdir())):
        found.append("a file left over")
    for path in source.iterdir():
        if path.is_file() and not path.is_symlink() and path.name not in words:
            if not (work / path.name).is_file() or (work / path.name).read_bytes() != path.read_bytes():
                found.append(f"{path.name} was changed")
    for name in OUTPUTS:
        if not (work / name).is_file():
            found.append(f"{name} is gone")
        elif (work / name).read_bytes() != OLD and (code not in (0, 1) or name not in " ".join(words)):
            found.append(f"{name} was changed")
    return found


def warm_up() -> None:
    """Import and compile what most commands use, so that forked processes start at once."""
    os.environ["IK_TOOLKIT_WAIT"] = "1"  # no compilation in the background
    lines = [f"info {name}" for name in ROBOTS]
    lines += [
        f"solve panda --xyz 0.4 0.1 0.4 -s {solver}" for solver in "lm dls pinv transpose ccd pid state-space".split()
    ]
    lines += ["solve planar_2r --xyz 1 1 0 -s newton", "solve inspection_7dof --xyz -0.5 0 0.7 --rpy 0 0 0 --all"]
    lines += ["track panda --duration 0.05"]
    with contextlib.redirect_stdout(io.StringIO()):
        for line in lines:
            code = main(line.split())
            if code in (130, 143):  # the signal was meant for us
                sys.exit(code)
    robot = ik.Robot.load("panda")
    ik.solve_batch(robot, [robot.fk(robot.home)] * 16, threads=1)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=2000)
    return parser.parse_args()


def run_all(seed: int, count: int, folder: Path) -> int:
    """Try `count` lines; returns the number of failures."""
    rng = random.Random(seed)  # noqa: S311  a test
    source = folder / "source"
    source.mkdir()
    lines = Lines(rng, hostile_files(source, rng))
    codes: dict[int, int] = {}
    failed = 0
    for k in range(count):
        words = lines.line()
        closed = rng.choice(((), (), (), (), (), (), (), (1,), (2,), (1, 2)))
        fresh(folder, source)
        code, said = run(words, folder, closed)
        codes[code] = codes.get(code, 0) + 1
        found = faults(folder, source, code, said, words)
        if found:
            failed += 1
            print(f"line {k}: {'; '.join(found)}\n  ik {shlex.join(words)[:600]!r} closed={closed}", flush=True)
            print("    " + "\n    ".join(ascii(line)[:300] for line in said.splitlines()[-6:]), flush=True)
    print(f"{count} command lines, seed {seed}: {failed} failed; exit codes {dict(sorted(codes.items()))}")
    return failed


if __name__ == "__main__":
    given = parse()
    warm_up()
    with tempfile.TemporaryDirectory() as place:
        sys.exit(1 if run_all(given.seed, given.count, Path(place)) else 0)
