"""`ik doctor`: what is installed, what is missing, and whether this machine can run it."""

import importlib.metadata
import importlib.util
import os
import platform
import tempfile
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import typer

from ..errors import extras
from . import first_use
from .command import command, flag, options
from .options import JsonOutput
from .output import notice, show, table, write_json

CORE = ("pin", "numpy", "numba", "typer", "rich")
COLOURS = {"ok": "green", "missing": "yellow", "mended": "yellow", "problem": "red"}
ROOM = 2**21  # Space [bytes] that the cache folder must have free. Each file of compiled code is smaller.
DEVELOPMENT = {"all", "test", "lint", "docs", "peers"}  # Extras that only developers need; they are not reported.


@options()
class DoctorOptions(JsonOutput):
    """Options of `ik doctor`: whether it compiles all code instead of checking the installation."""

    prepare: bool = flag(
        "--prepare", "Compile what the default solvers need now; about half a minute, once.", without=["--json"]
    )
    background: bool = flag("--background", "", hidden=True)


@command
def doctor(asked: DoctorOptions) -> None:
    """Check the installation: versions, extras, cache folder, robots.

    Uses no network. Damaged files of compiled code are removed; they are made again when needed. Exit code 1 when something
    is wrong; a missing extra is not.

    Examples:
    ik doctor
    ik doctor --prepare
    """
    if asked.prepare:
        _prepare(asked.background)
        return
    rows = [*_versions(), *_extras(), _compiler(), _cache(), *_background(), _pinocchio(), _robots()]
    healthy = all(row["state"] != "problem" for row in rows)
    write_json({"healthy": healthy, "checks": rows}, asked.as_json)
    if not asked.as_json:
        from rich.text import Text

        made = table("<what", "<state", "detail")
        for row in rows:
            made.add_row(row["what"], Text(row["state"], COLOURS[row["state"]]), row["detail"])
        show(made)
    if not healthy:
        raise typer.Exit(1)


def _prepare(background: bool) -> None:
    from ..compile.cache import folder
    from ..solvers.prepare import prepare

    place = folder()
    if place is None:
        notice("nothing is compiled now, because it could not be kept")
        return
    with first_use.only_one(place) if background else nullcontext(True) as alone:
        if alone:
            prepare(progress=notice)
    if not background:
        first_use.forget(place)


def _row(what: str, state: str, detail: str) -> dict[str, Any]:
    return {"what": what, "state": state, "detail": detail}


def _installed(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _versions() -> Iterator[dict[str, Any]]:
    from .. import __version__

    yield _row("ik_toolkit", "ok", f"{__version__}, {Path(__file__).resolve().parent.parent}")
    yield _row("python", "ok", f"{platform.python_version()}, {platform.system()} {platform.machine()}")
    for package in CORE:
        version = _installed(package)
        yield _row(package, "ok" if version else "problem", version or f"missing; run: pip install {package}")


def _extras() -> Iterator[dict[str, Any]]:
    """Yield a row of the report for each optional extra, read from the installed package's requirements."""
    for extra, packages in extras().items():
        if extra in DEVELOPMENT:
            continue
        versions = {package: _installed(package) for package in packages}
        missing = [package for package, version in versions.items() if version is None]
        if missing:
            detail = f"no {', '.join(missing)}; run: pip install {' '.join(missing)}"
        else:
            detail = ", ".join(f"{package} {version}" for package, version in versions.items())
        yield _row(f"extra {extra}", "missing" if missing else "ok", detail)


def _compiler() -> dict[str, Any]:
    """Report whether code is compiled through internal interfaces of numba (known releases only), or in numba's usual way."""
    try:
        import numba

        from ..compile.jit import OWN_WAY, TRIED
    except Exception as error:
        return _row("compiler", "problem", f"the kernels cannot be imported: {error}")
    if OWN_WAY:
        return _row("compiler", "ok", f"numba {numba.__version__} was tried with ik_toolkit")
    slow = f"is none of those tried ({', '.join(TRIED)}): compiling takes longer, the first time"
    return _row("compiler", "ok", f"numba {numba.__version__} {slow}")


def _background() -> Iterator[dict[str, Any]]:
    """Report the state of a compilation in the background: running or failed; nothing if there is none."""
    from ..compile.cache import folder

    place = folder()
    if place is None:
        return
    if first_use.compiling(place):
        yield _row("background compiling", "ok", f"at work, see {place / first_use.LOG}")
    elif why := first_use.died(place):
        yield _row("background compiling", "problem", why)


def _cache() -> dict[str, Any]:
    """Report where compiled code is cached, whether there is space, and whether files are damaged; damaged ones are removed."""
    try:
        from ..compile.cache import damaged, open_to_others
        from ..kernel.chain import forward_kinematics

        folder, broken = damaged(forward_kinematics)
    except Exception as error:  # Whatever is broken, this row says so and the others of the report are still made.
        return _row("compile cache", "problem", f"the kernels cannot be imported: {error}")
    if folder is None:
        why = getattr(getattr(forward_kinematics, "_cache", None), "why", "NUMBA_DISABLE_JIT is set")
        return _row("compile cache", "missing", f"every process compiles again ({why}); set NUMBA_CACHE_DIR")
    place = Path(forward_kinematics._cache.cache_path)
    if why := open_to_others(place):
        remedy = f"chmod go-w {place}, or set NUMBA_CACHE_DIR to a folder of your own"
        return _row("compile cache", "problem", f"{why}, so every process compiles again: {place}; {remedy}")
    try:
        for path in broken:
            path.unlink()
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place) as file:
            file.write(bytes(ROOM))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return _row("compile cache", "problem", f"{error.strerror}: {folder}; free it or set NUMBA_CACHE_DIR")
    if broken:
        names = ", ".join(path.name for path in broken[:3]) + (", ..." if len(broken) > 3 else "")
        return _row("compile cache", "mended", f"{len(broken)} damaged file(s) removed from {folder}: {names}")
    return _row("compile cache", "ok", f"writable, no damaged files: {folder}")


def _pinocchio() -> dict[str, Any]:
    """Report whether the right Pinocchio is installed: PyPI's 'pinocchio' is another package, and old releases are not enough."""
    stranger = _installed("pinocchio")
    if stranger:
        return _row("pinocchio", "problem", f"package 'pinocchio' {stranger} hides 'pin'; run: pip uninstall pinocchio")
    try:
        import pinocchio
    except ImportError as error:
        return _row("pinocchio", "problem", f"cannot be imported: {error}")
    if not hasattr(pinocchio, "buildModelFromXML"):
        stranger = f"{pinocchio.__file__} is not the rigid-body library; pip install --force-reinstall pin"
        return _row("pinocchio", "problem", stranger)
    return _row("pinocchio", "ok", f"{pinocchio.__version__} imports")


def _robots() -> dict[str, Any]:
    from ..errors import IKError
    from ..robot.library import list_robots, shipped_robots

    try:
        shipped, every = shipped_robots(), list_robots()
    except IKError as error:
        return _row("robots", "problem", str(error))
    absent = [name for name, entry in shipped.items() if entry.path is None or not entry.path.is_file()]
    if absent:
        return _row("robots", "problem", f"files missing of: {', '.join(absent)}; reinstall ik_toolkit")
    return _row("robots", "ok", f"{len(shipped)} shipped, {len(every) - len(shipped)} from example-robot-data")
