"""Pictures of an answer: a chart, a page, the scene in the browser."""

import signal
import threading
from pathlib import Path
from typing import Any

from ..errors import InvalidOption
from .output import notice
from .streams import handling


def draw(arm: Any, what: Any, target: Any, around: Any, plot: Path | None, html: Path | None, live: bool) -> None:
    """Draw a result of a solve: its errors over the iterations as a chart, the robot in 3-D as a page, or in the browser.

    what: a result with history, or a list of solutions if there is no `plot`. target: as for `view`. around: the solve's
    avoid_collisions, whose obstacles are drawn. plot, html: files of the chart and the page, or None. live: whether to open the
    browser.
    """
    if plot is not None and len(what.history["q"]) < 2:
        notice("no plot: the solve took no step")
    elif plot is not None:
        from ..show.plots import convergence, save

        title = f"{arm.name}, {what.solver}: {what.status.name}"
        notice(f"wrote {save(convergence(what, title=title), plot)}")
    model = None if isinstance(around, bool | None) else around
    show_scene(arm, what, html, live, target=getattr(target, "T_base_tip", target), obstacles=model)


def chart(file: Path | None, what: Any, arm: Any = None) -> None:
    """Draw the chart of a result to a file, and print a notice; nothing happens if `file` is None."""
    if file is not None:
        from ..show.plot import plot

        plot(what, arm, file=file)
        notice(f"wrote {file}")


def show_scene(arm: Any, what: Any, html: Path | None, live: bool = False, **more: Any) -> None:
    """Show a result in 3-D: write the page `html`, unless that is None, and open the browser if `live`.

    more: further arguments of `view`.
    """
    if html is not None or live:
        from ..show.scene import view

        present(view(arm, what, **more), html, live)


def present(scene: Any, html: Path | None, live: bool, port: int = 0, browse: bool = True) -> None:
    """Write a Scene to the page `html`, unless that is None; if `live`, show it in the browser until Ctrl-C or SIGTERM."""
    incomplete(scene)
    if html is not None:
        written(scene.save(html))
    if not live:
        return
    try:
        url = scene.serve(port)
    except OSError as error:
        raise InvalidOption(f"port {port} cannot be used: {error.strerror or error}") from None
    wait(f"the scene is at {url}", url, browse)
    scene.close()


def incomplete(scene: Any) -> None:
    """Print a notice if parts of the robot could not be drawn, with advice on missing meshes."""
    if scene.body.notice:
        meshes = "; --package-dir names a folder to search for them" if "mesh" in scene.body.notice else ""
        notice(f"{scene.body.notice}{meshes}")


def written(page: Path) -> None:
    """Print a notice that a page was written, and its size."""
    notice(f"wrote {page} ({page.stat().st_size / 1e6:.1f} MB, opens without a network)")


def wait(announcement: str, url: str, browse: bool) -> None:
    """Print an announcement of the page at `url`, open it in a browser if `browse`, and wait for Ctrl-C or SIGTERM."""
    done = threading.Event()
    try:
        with handling([signal.SIGTERM], lambda *_: done.set()):
            notice(f"{announcement}  (Ctrl-C ends it)")
            if browse:
                import webbrowser

                threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
            while not done.wait(0.5):
                pass
    except KeyboardInterrupt:
        notice("")
