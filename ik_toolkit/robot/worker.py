"""A confined process that answers one question about a file: what strangers wrote may crash or exhaust it, and nothing else."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from ..errors import ModelError


def ask(
    script: Path, does: str, silent: str, *, memory: int, seconds: int, folder: str | None = None, **job: Any
) -> dict[str, Any]:
    """Run a script with a job (JSON on stdin); its answer is the last line it prints, {"error": sentence} if it cannot.

    does: what the process is for; silent: the error if it says nothing. memory [bytes] and seconds of processor time are caps that
    the script sets for itself. folder: where it runs. Raises ModelError when it cannot be started.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(script)],
            input=json.dumps({**job, "memory": memory, "seconds": seconds}),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=folder,
            timeout=6.0 * seconds,  # of wall time: a busy machine
            check=False,
        )
        return json.loads((done.stdout.strip().splitlines() or [""])[-1])
    except (subprocess.TimeoutExpired, ValueError):
        return {"error": silent}
    except OSError as error:
        raise ModelError(f"the process that {does} cannot be started: {error.strerror}") from None
