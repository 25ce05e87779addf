"""A visitor of the panel: one thread that runs its requests, newest first, undo, error messages, and camera control."""

import html
import queue
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...errors import IKError
from ...style import BAD
from .session import Session
from .solve_tab import Goal


class Worker:
    """Runs jobs one after another in its own thread; a newer job of the same name replaces a waiting one."""

    def __init__(self) -> None:
        """Start the thread."""
        self.ended = False
        self._jobs: dict[str, Callable[[], None]] = {}
        self._names: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._run, daemon=True, name="ik panel visitor").start()

    def post(self, name: str, job: Callable[[], None]) -> None:
        """Add a job, a function without arguments, to the queue; it replaces a waiting job of the same name."""
        self._jobs[name] = job
        self._names.put(name)

    def _run(self) -> None:
        while True:
            name = self._names.get()
            if self.ended:
                self._jobs.clear()  # Waiting jobs would change a scene that no longer exists.
                return
            # A job that replaced a waiting one runs in that one's place; its own place in the queue then finds nothing to do.
            self._jobs.pop(name, lambda: None)()
            self._names.task_done()

    def idle(self, timeout: float = 30.0) -> bool:
        """Wait until all jobs are done, at most `timeout` [s]; return whether they are."""
        with self._names.all_tasks_done:
            return self._names.all_tasks_done.wait_for(lambda: not self._names.unfinished_tasks, timeout)

    def end(self) -> None:
        """End the thread after the current job."""
        self.ended = True
        self._names.put("")


KEPT = 100  # largest number of changes that can be undone
TOGETHER = 1.0  # [s] Changes of one kind, such as a drag, that follow each other within this time are undone together.


class Past:
    """The undo history of one visitor: joint values q (n,) and target poses (4, 4) by tip from before each change."""

    def __init__(self) -> None:
        """Start with an empty history."""
        self._entries: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
        self._last = "", 0.0

    def note(self, name: str, q: np.ndarray, targets: dict[str, Any]) -> None:
        """Store joint values q (n,) and target poses from before a change of kind `name`, unless it continues the last."""
        now = time.monotonic()
        kind, at = self._last
        self._last = name, now
        if kind != name or now - at > TOGETHER:
            self._entries = [*self._entries[1 - KEPT :], (q.copy(), {tip: T.copy() for tip, T in targets.items()})]

    def back(self) -> tuple[np.ndarray, dict[str, np.ndarray]] | None:
        """Remove and return the state before the last change, or None if there is none."""
        self._last = "", 0.0
        return self._entries.pop() if self._entries else None


PLAIN = "#37424f"
QUIET = (71, 85, 105)  # colour of secondary buttons
LONGEST = 600  # largest number of characters of a status message
STYLE = """<style>@media (max-width: 36em) {  /* a phone: controls below, the robot above them, see viser_scene.Picture */
div[style*="width: 20em"] { width: 100% !important; max-height: 50% !important }}</style>"""


def empty(folder: Any) -> None:
    """Remove all controls of a folder (a viser handle) from the page."""
    for child in list(folder._children.values()):
        child.remove()


class Visit:
    """One visitor of the panel: runs the jobs of the page's controls, which subclasses build, in a thread of its own."""

    def __init__(
        self, client: Any, source: str, tips: str | Sequence[str] | None = None, *, files: bool = True
    ) -> None:
        """Build the first robot's controls in the visitor's own thread."""
        self.client, self.gui, self.scene = client, client.gui, client.scene
        self.stage: Any = None
        # parts of the page that stay None where a subclass does not build them
        self.chart = self.found = self.around = self.learn = self.status = None
        self.aspect = 0.0  # width over height of the visitor's picture when the camera was last aimed
        self.files = files
        self.session = Session(source, tips)
        self.kinds: dict[str, str] = {}
        self.live, self.frames = True, False
        self.past = Past()
        self.goals: list[Goal] = []
        self.worker = Worker()
        self.worker.post("build", self._guard(self.build))
        client.camera.on_update(lambda _: self._resized())

    def close(self) -> None:
        """End the visitor's thread."""
        self.worker.end()

    def _guard(self, job: Callable[[], None]) -> Callable[[], None]:
        """Wrap a job so that user errors become messages and anything else is reported as a bug; the thread never ends."""

        def run() -> None:
            try:
                job()
                return
            except IKError as error:
                words = str(error)
            except Exception as error:
                words = f"unexpected {type(error).__name__}: {error} (a bug of ik_toolkit)"
            if not self.worker.ended:  # After the visitor has left, there is no page to show a message on.
                self.say(words, BAD)

        return run

    def _on(self, handle: Any, name: str, job: Callable[[], None]) -> Any:
        """Run a job when the visitor changes or clicks a control, but not when this program does; return the control."""
        listen = getattr(handle, "on_click", None) or handle.on_update

        @listen
        def _(event: Any) -> None:
            if event.client is not None:
                self._post(name, job)

        return handle

    def _ask(self, handle: Any, name: str, job: Callable[[Any], None]) -> Any:
        """Run a job with the new value of a control when the visitor changes it; return the control."""
        return self._on(handle, name, lambda: job(handle.value))

    def _button(
        self, text: str, name: str, job: Callable[[], None], color: Any = QUIET, hint: str | None = None
    ) -> Any:
        """Add a button that runs a job; return it."""
        return self._on(self.gui.add_button(text, color=color, hint=hint), name, job)

    def _dialog(self, title: str, content: str) -> None:
        """Show HTML in a window of its own with a button that closes it."""
        with self.gui.add_modal(title) as modal:
            self.gui.add_html(content)
            self.gui.add_button("Close").on_click(lambda _: modal.close())

    def _post(self, name: str, job: Callable[[], None]) -> None:
        """Queue a visitor's job, and record the state before it in case it moves the robot."""

        def noted() -> None:
            s, robot, q = self.session, self.session.robot, self.session.q
            targets = {goal.tip: goal.handle.target for goal in self.goals} if self.stage else {}
            job()
            if s.robot is robot and not np.array_equal(s.q, q) and name != "undo":
                self.past.note(name, q, targets)

        self.worker.post(name, self._guard(noted))

    def say(self, text: str, color: str = PLAIN, instead_of: str | None = None) -> None:
        """Show a sentence in the status line. If `instead_of` is given, do so only if the line still has this content."""
        text = text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."
        if self.status is None or instead_of not in (None, self.status.content):
            return
        self.status.content = (
            f'{STYLE}<div role="status" style="padding:4px 12px;color:{color};font-size:13px;line-height:1.4;min-height:2.8em">'
            f"{html.escape(text)}</div>"
        )

    def _resized(self) -> None:
        """Aim the camera again after the picture's shape changed: the controls were docked, or a phone was rotated."""
        width, height = self.client.camera.image_width, self.client.camera.image_height
        aspect = width / max(height, 1)
        if abs(aspect - self.aspect) > 0.05 and self.stage is not None:
            self.aspect = aspect
            self.worker.post("aim", self._guard(lambda: self.stage.aim(self.session.q)))

    def build(self) -> None:
        """Build the page anew for the session's robot; subclasses do this."""
        raise NotImplementedError
