"""Subprocess that expands xacro for `xacro.py`: macros are a programming language, so they run sandboxed.

It imports nothing from the toolkit except packages.py and mesh_worker.py. Job (JSON on stdin): file, arguments (name -> value),
package_dirs, folders (files are read only from these and from packages that are found), environment (ROS package path
variables), memory [bytes], seconds. It prints one line of JSON: {"urdf": text, "asked": names} or {"error": sentence}.
"""

import contextlib
import importlib.util
import io
import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CALLS = (  # prefixes of audit events
    "subprocess.", "os.system", "os.exec", "os.spawn", "os.posix_spawn", "os.fork", "pty.", "socket.", "ctypes.", "shutil.",
    "os.remove", "os.rename", "os.mkdir", "os.link", "os.symlink",
)  # fmt: skip


def beside(name: str) -> ModuleType:
    """The module of this name in this folder; a script cannot import it from the package."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Asked(dict):
    """Arguments that note the names they were asked for, so that a misspelled one shows."""

    def __init__(self, given: dict[str, str]) -> None:
        """Take the arguments; nothing has been asked yet."""
        super().__init__(given)
        self.names: set[str] = set()

    def __contains__(self, name: object) -> bool:
        """Whether there is an argument of this name, which is noted."""
        self.names.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        """The argument of this name, which is noted."""
        self.names.add(name)
        return super().__getitem__(name)


class NotAllowed(Exception):
    """A forbidden operation; not an OSError, which xacro would rewrite."""


class Walls:
    """Sandbox: after `build` this process reads only some folders and Python's own; it cannot write, connect or start processes."""

    def __init__(self, folders: list[str]) -> None:
        self.folders = [
            os.path.realpath(folder) for folder in (*folders, sys.prefix, sys.base_prefix, os.path.dirname(os.__file__))
        ]
        self.open = False

    def build(self) -> None:
        """Activate the sandbox."""
        sys.addaudithook(self.watch)

    def watch(self, event: str, arguments: tuple) -> None:
        """Audit hook: raise NotAllowed for a forbidden operation."""
        if event == "open" and isinstance(arguments[0], str | bytes):
            path, mode, flags = arguments
            real = os.path.realpath(os.fsdecode(path))
            writes = (flags or 0) & WRITES or any(letter in (mode or "") for letter in "wax+")
            inside = self.open or any(real == root or real.startswith(root + os.sep) for root in self.folders)
            if writes or not inside:
                what = "writes" if writes else "reads"
                raise NotAllowed(f"it {what} '{os.fsdecode(path)[:200]}', which is not allowed")
        elif event.startswith(CALLS):
            raise NotAllowed(f"it calls {event}, which is not allowed")


def expand(job: dict) -> dict:
    """Run a job."""
    import xacro
    import xacro.substitution_args as substitution
    import yaml  # noqa: F401 - xacro loads it late

    packages = beside("packages")
    walls = Walls(job["folders"])
    known: dict[str, str] = {}
    arguments = Asked(job["arguments"])

    def find(name: str) -> str:
        if name not in known:
            walls.open = True
            found = packages.find_package(name, Path(job["file"]), job["package_dirs"], job["environment"])
            walls.open = False
            if found is None:
                raise LookupError(f"there is no package '{name[:100]}'; name its folder with package_dirs")
            known[name] = str(found)
            walls.folders.append(str(found))
        return known[name]

    def env(name: str) -> str:
        if name not in arguments:
            raise NotAllowed(
                f"it reads $(env {name[:100]}); the environment is not read, give {name[:100]} as an argument"
            )
        return arguments[name]

    def optenv(name: str, default: str = "") -> str:
        return arguments[name] if name in arguments else default

    beside_the_file = xacro.abs_filename_spec

    def included(name: str) -> str:
        scheme, _, rest = name.partition("://")
        if scheme != "package":
            return beside_the_file(name)
        package, _, inner = rest.partition("/")
        return os.path.join(find(package), inner)

    substitution._eval_find, substitution._eval_env, substitution._eval_optenv = find, env, optenv
    substitution._eval_dict.update(find=find, env=env, optenv=optenv)
    xacro.abs_filename_spec = included
    os.environ.clear()
    walls.build()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            document: Any = xacro.process_file(job["file"], mappings=arguments)
        return {"urdf": document.toprettyxml(indent="  "), "asked": sorted(arguments.names)}
    except BaseException as error:  # broken macros can raise anything
        stack = [os.path.basename(name) for name in (xacro.filestack or []) if name]
        cause = getattr(error, "exc", None) or error
        if isinstance(cause, FileNotFoundError):
            stack, cause = stack[:-1], f"there is no file '{cause.filename}'"
        said = " ".join(str(cause).split())[:300] or type(error).__name__
        return {"error": f"{said} (in '{stack[-1]}')" if stack else said}


def main() -> None:
    """Read the job from stdin, write the answer to stdout."""
    job = json.load(sys.stdin)
    limit = beside("mesh_worker").limit
    limit("CORE", 0)
    limit("AS", job["memory"])
    limit("CPU", job["seconds"])
    print(json.dumps(expand(job)))


if __name__ == "__main__":
    main()
