"""Xacro -> URDF text, expanded by a process of its own that is confined (see xacro_worker.py)."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from ..errors import InvalidOption, MissingExtra, ModelError

WORKER = Path(__file__).with_name("xacro_worker.py")
MEMORY = 1_000_000_000  # bytes; large robots take 0.1 GB
SECONDS = 20  # of processor time; large robots take 2 s
ENVIRONMENT = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")


def expand(path: Path, package_dirs: Iterable[str | Path] = (), arguments: Mapping[str, object] | None = None) -> str:
    """URDF text of a xacro file.

    arguments: values of its <xacro:arg> by name. Files are read from the file's own folder, the package it lies in,
    package_dirs and the packages it finds; nothing is written, no command run, no environment read. Raises MissingExtra,
    InvalidOption (arguments), ModelError: one sentence that names the file.
    """
    if importlib.util.find_spec("xacro") is None:
        raise MissingExtra("xacrodoc", "formats")
    given = {}
    for name, value in (arguments or {}).items():
        if not isinstance(name, str) or not isinstance(value, str | int | float):
            raise InvalidOption(f"xacro_args are names with a text or a number each, not {name!r:.60}: {value!r:.60}")
        given[name] = str(value).lower() if isinstance(value, bool) else str(value)
    file = path.expanduser().resolve()
    folders = [str(Path(folder).expanduser().resolve()) for folder in package_dirs]
    package = [str(folder) for folder in file.parents if (folder / "package.xml").is_file()]
    job = {
        "file": str(file),
        "arguments": given,
        "package_dirs": folders,
        "folders": [str(file.parent), *package[:1], *folders],
        "environment": {name: os.environ[name] for name in ENVIRONMENT if name in os.environ},
        "memory": MEMORY,
        "seconds": SECONDS,
    }
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(WORKER)],
            input=json.dumps(job),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            timeout=6.0 * SECONDS,  # of wall time: a busy machine
            check=False,
        )
        answer = json.loads(done.stdout.strip() or '{"error": "it took too much time or memory"}')
    except (subprocess.TimeoutExpired, ValueError):
        answer = {"error": "it took too much time or memory"}
    except OSError as error:
        raise ModelError(f"the process that expands xacro cannot be started: {error.strerror}") from None
    if "error" in answer:
        raise ModelError(f"'{path.name}' cannot be expanded: {answer['error']}")
    if "<link" not in answer["urdf"]:
        raise ModelError(f"'{path.name}' holds xacro macros and no robot; load the file that uses them")
    return answer["urdf"]
