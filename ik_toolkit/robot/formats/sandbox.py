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
    """Run a Python script in a process and return the lines it printed, and whether it ended within `seconds` of wall time.

    The script gets `job` as JSON on its standard input. `does` completes "the process that ..." in an error message, `folder` is
    its working directory and `environment` has further environment variables. Raises ModelError if it cannot be started.
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
    """Run a Python script in a process and return the JSON in the last line that it prints; {"error": sentence} after a failure.

    The script gets `job` as JSON on its standard input, with `memory` [bytes] and `seconds` of processor time, which it sets as its
    own limits. `silent` is the error sentence if it prints nothing. `does` completes "the process that ..." in an error message.
    """
    job |= {"memory": memory, "seconds": seconds}
    # The limit on wall time allows for a busy machine, on which other processes hold the processor.
    lines, ended = run(script, does, job, 10.0 * seconds, folder)
    try:
        return json.loads(lines[-1]) if ended and lines else {"error": silent}
    except ValueError:
        return {"error": silent}


def limit(what: str, value: int) -> None:
    """Lower the limit of a resource of this process, such as 'CPU' [s] or 'AS' [bytes], where the system supports it."""
    with contextlib.suppress(ImportError, AttributeError, ValueError, OSError):
        import resource

        number = getattr(resource, f"RLIMIT_{what}")
        hard = resource.getrlimit(number)[1]
        resource.setrlimit(number, (value if hard < 0 else min(value, hard), hard))
