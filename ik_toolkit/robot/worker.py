"""A subprocess that answers one question about an untrusted file, which can crash or exhaust only that process."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from ..errors import ModelError


def ask(
    script: Path, does: str, silent: str, *, memory: int, seconds: int, folder: str | None = None, **job: Any
) -> dict[str, Any]:
    """Run a script with a job (JSON on stdin); the answer is the last line it prints, {"error": sentence} on failure.

    does: purpose of the process, for messages; silent: the error if it prints nothing. memory [bytes] and seconds of processor time
    are caps that the script sets for itself; nothing in a file makes it wait, so that on an idle machine they are its wall time
    too. folder: working folder. Raises ModelError if it cannot be started.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(script)],
            input=json.dumps({**job, "memory": memory, "seconds": seconds}),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=folder,
            timeout=10.0 * seconds,  # wall time: allows for a busy machine, on which others hold the processor
            check=False,
        )
        return json.loads((done.stdout.strip().splitlines() or [""])[-1])
    except (subprocess.TimeoutExpired, ValueError):
        return {"error": silent}
    except OSError as error:
        raise ModelError(f"the process that {does} cannot be started: {error.strerror}") from None
