"""One thread that runs a visitor's jobs, newest first."""

import threading
from collections.abc import Callable


class Worker:
    """Runs jobs one after another in its own thread; a newer job of the same name replaces a waiting one."""

    def __init__(self) -> None:
        """Start the thread."""
        self.ended = False
        self._jobs: dict[str, Callable[[], None]] = {}
        self._wake = threading.Condition()
        self._busy = False
        threading.Thread(target=self._run, daemon=True, name="ik panel visitor").start()

    def post(self, name: str, job: Callable[[], None]) -> None:
        """Queue a job."""
        with self._wake:
            self._jobs[name] = job
            self._wake.notify_all()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._busy = False
                self._wake.notify_all()
                self._wake.wait_for(lambda: self._jobs or self.ended)
                if self.ended:
                    self._jobs.clear()  # they keep references to the visitor's scene
                    return
                job = self._jobs.pop(next(iter(self._jobs)))
                self._busy = True
            job()

    def idle(self, timeout: float = 30.0) -> bool:
        """Wait until all jobs are done."""
        with self._wake:
            return self._wake.wait_for(lambda: not self._jobs and not self._busy, timeout)

    def end(self) -> None:
        """End the thread after the current job."""
        with self._wake:
            self.ended = True
            self._wake.notify_all()
