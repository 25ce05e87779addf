"""Asks a subprocess one question about an untrusted file, which can crash or exhaust that process only."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...errors import ModelError


def run(
    script: Path, does: str, job: Mapping[str, Any], seconds: float, folder: str | None = None, **environment: str
) -> tuple[list[str], bool]:
    """Run a script with a job (JSON on stdin) and return the lines it prints, and whether it ended within a wall time [s].

    `does` says in messages what the process is for. Raises ModelError if it cannot be started.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(script)],
            input=json.dumps(job),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=folder,
            timeout=seconds,
            env={**os.environ, **environment},
            check=False,
        )
        return done.stdout.splitlines(), True
    except subprocess.TimeoutExpired as error:
        said = error.stdout or ""
        return (said.decode(errors="replace") if isinstance(said, bytes) else said).splitlines(), False
    except OSError as error:
        raise ModelError(f"the process that {does} cannot be started: {error.strerror}") from None


def ask(
    script: Path, does: str, silent: str, *, memory: int, seconds: int, folder: str | None = None, **job: Any
) -> dict[str, Any]:
    """Run a script and return the JSON on its last line, which is {"error": sentence} after a failure.

    `silent` is the error if it prints nothing. memory [bytes] and seconds of processor time are caps that the script sets for
    itself; nothing in a file makes it wait, so on an idle machine the wall time is the same.
    """
    job |= {"memory": memory, "seconds": seconds}
    # The limit on wall time allows for a busy machine, on which other processes hold the processor.
    lines, ended = run(script, does, job, 10.0 * seconds, folder)
    try:
        return json.loads(lines[-1]) if ended and lines else {"error": silent}
    except ValueError:
        return {"error": silent}


def limit(what: str, value: int) -> None:
    """Limit a resource of this process where the system supports it."""
    with contextlib.suppress(ImportError, AttributeError, ValueError, OSError):
        import resource

        number = getattr(resource, f"RLIMIT_{what}")
        hard = resource.getrlimit(number)[1]
        resource.setrlimit(number, (value if hard < 0 else min(value, hard), hard))
