"""A real browser for tests: Playwright driving Chromium. Tests that use it are skipped if either is missing."""

import contextlib
import os
import shutil
import time

import pytest

api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (pip install playwright)")
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
NEEDED = pytest.mark.skipif(CHROMIUM is None, reason="no chromium found (apt-get install chromium, or set CHROMIUM)")
FLAGS = (
    "--no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update --disable-sync "
    "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --ignore-gpu-blocklist"
).split()
PATIENCE = 60_000  # ms; a software renderer on a busy machine is slow


@contextlib.contextmanager
def started():
    """A browser of our own."""
    with (
        api.sync_playwright() as play,
        play.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS) as made,
    ):
        yield made


@contextlib.contextmanager
def fresh_page(browser, **context):
    """A page without a past that notes what it asks outside this machine, and what goes wrong in it."""
    with browser.new_context(**{"viewport": {"width": 800, "height": 520}, **context}) as fresh:
        page = fresh.new_page()
        page.set_default_timeout(PATIENCE)
        page.outside, page.errors = [], []

        def note(request):
            if not request.url.startswith(("http://127.0.0.1", "ws://127.0.0.1", "data:", "blob:", "file:")):
                page.outside.append(request.url)

        page.on("request", note)
        page.on("pageerror", lambda error: page.errors.append(str(error)))
        page.on("dialog", lambda dialog: page.errors.append(dialog.message))
        yield page


@contextlib.contextmanager
def plainly_lit(robot):
    """A panel without shadows and reflections: drawn by software, they are more than half of the work of a page."""
    pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
    from ik_toolkit.show.panel.panel import Panel

    with contextlib.closing(Panel(robot)) as made:
        made.server.scene.configure_default_lights(cast_shadow=False)
        made.server.scene.configure_environment_map(None)
        yield made


def until(page, condition):
    """Wait until a condition holds; a page's security policy lets the browser itself wait for none of ours."""
    end = time.monotonic() + PATIENCE / 1000
    while not condition():
        assert time.monotonic() < end, "what was asked for did not happen"
        page.wait_for_timeout(100)
