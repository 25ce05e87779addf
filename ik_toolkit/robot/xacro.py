"""Xacro -> URDF text, expanded in a sandboxed subprocess (see xacro_worker.py)."""

import importlib.util
import logging
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from ..errors import InvalidOption, MissingExtra, ModelError, near_match
from .worker import ask

WORKER = Path(__file__).with_name("xacro_worker.py")
MEMORY = 1_000_000_000  # bytes; large robots take 0.1 GB
SECONDS = 20  # of processor time; large robots take 2 s
ENVIRONMENT = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")


def expand(path: Path, package_dirs: Iterable[str | Path] = (), arguments: Mapping[str, object] | None = None) -> str:
    """URDF text of a xacro file.

    arguments: values of its <xacro:arg>, and of $(env NAME), by name. Files are read from the file's own folder, the package it
    is in, package_dirs and the packages it finds; nothing is written, no command run, no environment read. An argument that it
    does not use is logged: it may be misspelled. Raises MissingExtra, InvalidOption (arguments), ModelError: one sentence that
    names the file.
    """
    if importlib.util.find_spec("xacro") is None:
        raise MissingExtra("xacrodoc", "formats")
    given = {}
    for name, value in (arguments or {}).items():
        if not isinstance(name, str) or not isinstance(value, str | int | float):
            raise InvalidOption(f"xacro_args must map names to strings or numbers, not {name!r:.60}: {value!r:.60}")
        given[name] = str(value).lower() if isinstance(value, bool) else str(value)
    file = path.expanduser().resolve()
    folders = [str(Path(folder).expanduser().resolve()) for folder in package_dirs]
    package = [str(folder) for folder in file.parents if (folder / "package.xml").is_file()]
    answer = ask(
        WORKER,
        "expands xacro",
        "it took too much time or memory",
        memory=MEMORY,
        seconds=SECONDS,
        file=str(file),
        arguments=given,
        package_dirs=folders,
        folders=[str(file.parent), *package[:1], *folders],
        environment={name: os.environ[name] for name in ENVIRONMENT if name in os.environ},
    )
    if "error" in answer:
        raise ModelError(f"'{path.name}' cannot be expanded: {answer['error']}")
    if "<link" not in answer["urdf"]:
        raise ModelError(f"'{path.name}' contains xacro macros but no robot; load the file that uses them")
    for name in given.keys() - set(answer["asked"]):
        hint = near_match(name, answer["asked"])
        logging.getLogger("ik_toolkit").warning("'%s' does not use the argument '%s'.%s", path.name, name, hint)
    return answer["urdf"]
