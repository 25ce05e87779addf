"""Expands xacro to URDF or SRDF text in a subprocess with limits on time and memory (see xacro_worker.py)."""

import importlib.util
import logging
import os
from collections.abc import Iterable, Mapping
from numbers import Number
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InvalidOption, MissingExtra, ModelError, near_match
from .sandbox import ask

WORKER = Path(__file__).with_name("xacro_worker.py")
MEMORY = 1_000_000_000  # Memory cap [bytes] of the process that expands a file. Large robots take 0.1 GB.
# Cap on the processor time [s] of the process that expands a xacro file. Robots take 0.1 to 0.3 s.
SECONDS = 3
ENVIRONMENT = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")


def has_macros(srdf: Any) -> bool:
    """Return whether an SRDF is given as the name of a .xacro file."""
    return isinstance(srdf, str | Path) and str(srdf).endswith(".xacro")


def expanded(srdf: Any, package_dirs: Iterable[str | Path] = (), arguments: Mapping[str, object] | None = None) -> Any:
    """Return the option `srdf` with a xacro file replaced by the SRDF text to which it expands; anything else unchanged.

    Raises MissingExtra without xacro, InvalidOption for wrong arguments, ModelError.
    """
    return expand(Path(srdf), package_dirs, arguments, "group") if has_macros(srdf) else srdf


def expand(
    path: Path,
    package_dirs: Iterable[str | Path] = (),
    arguments: Mapping[str, object] | None = None,
    holds: str = "link",
) -> str:
    """Expand a xacro file to the text of a URDF or an SRDF.

    `holds` is the element that the result must have, 'link' for a URDF or 'group' for an SRDF. `arguments` maps the names of its
    <xacro:arg> and of $(env NAME) to values. Files are read from the file's own folder, its package, package_dirs and the packages
    it finds; nothing in them is evaluated as Python, and no environment variable is read. An argument that a URDF does not use is
    logged, because it may be misspelled. Raises MissingExtra if xacro is not installed, InvalidOption for wrong arguments,
    ModelError, one sentence that names the file, if it cannot be expanded.
    """
    if importlib.util.find_spec("xacro") is None:
        raise MissingExtra("xacrodoc", "formats")
    given = {}
    for name, value in (arguments or {}).items():
        if not isinstance(name, str) or not isinstance(value, str | Number | np.bool | Path):
            raise InvalidOption(
                f"xacro_args must map names to strings, numbers or paths, not {name!r:.60}: {value!r:.60}"
            )
        given[name] = str(value).lower() if isinstance(value, bool | np.bool) else str(value)
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
    if f"<{holds}" not in answer["urdf"]:
        what = "robot" if holds == "link" else holds
        raise ModelError(f"'{path.name}' contains xacro macros but no {what}; load the file that uses them")
    for name in given.keys() - set(answer["asked"]) if holds == "link" else ():
        hint = near_match(name, answer["asked"])
        logging.getLogger("ik_toolkit").warning("'%s' does not use the argument '%s'.%s", path.name, name, hint)
    return answer["urdf"]
