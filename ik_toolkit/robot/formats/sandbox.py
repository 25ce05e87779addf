"""Asks a subprocess one question about an untrusted file, which can crash or exhaust that process only."""

import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from ...errors import ModelError


def ask(
    script: Path, does: str, silent: str, *, memory: int, seconds: int, folder: str | None = None, **job: Any
) -> dict[str, Any]:
    """Run a script with a job (JSON on stdin) and return the JSON on its last line, which is {"error": sentence} after a failure.

    `does` says in messages what the process is for, `silent` is the error if it prints nothing. memory [bytes] and
    seconds of processor time are caps that the script sets for itself; nothing in a file makes it wait, so on an idle
    machine the wall time is the same. Raises ModelError if the process cannot be started.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(script)],
            input=json.dumps({**job, "memory": memory, "seconds": seconds}),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=folder,
            # The limit on wall time allows for a busy machine, on which other processes hold the processor.
            timeout=10.0 * seconds,
            check=False,
        )
        return json.loads((done.stdout.strip().splitlines() or [""])[-1])
    except (subprocess.TimeoutExpired, ValueError):
        return {"error": silent}
    except OSError as error:
        raise ModelError(f"the process that {does} cannot be started: {error.strerror}") from None


def limit(what: str, value: int) -> None:
    """Limit a resource of this process where the system supports it."""
    with contextlib.suppress(ImportError, AttributeError, ValueError, OSError):
        import resource

        number = getattr(resource, f"RLIMIT_{what}")
        hard = resource.getrlimit(number)[1]
        resource.setrlimit(number, (value if hard < 0 else min(value, hard), hard))
