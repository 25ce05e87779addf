"""A panel and a visitor's desk, without a browser, of the robot that a test module names as ROBOT."""

import contextlib
import types

import pytest

LENS = {"image_width": 800, "image_height": 600, "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 0.0), "fov": 0.7}


@pytest.fixture(autouse=True)
def camera(monkeypatch):
    """The camera of a visitor's page, which the server itself has not: pages are built on it here, too."""
    with contextlib.suppress(ImportError):
        import viser

        made = types.SimpleNamespace(**LENS, on_update=lambda call: None)
        monkeypatch.setattr(viser.ViserServer, "camera", made, raising=False)


@pytest.fixture(scope="module")
def browser():
    """A browser for the tests of a module, which are skipped where there is none."""
    chromium = pytest.importorskip("chromium")
    if chromium.CHROMIUM is None:
        pytest.skip("no chromium found (apt-get install chromium, or set CHROMIUM)")
    with chromium.started() as made:
        yield made


@pytest.fixture(scope="module")
def panel(request):
    from ik_toolkit.show.panel.panel import Panel

    with contextlib.closing(Panel(request.module.ROBOT)) as made:
        yield made


@pytest.fixture
def desk(panel, request):
    """A visitor's desk on the server itself: the same controls as a browser's, without one."""
    from ik_toolkit.show.panel.page import PanelPage

    made = PanelPage(panel.server, request.module.ROBOT)
    assert made.worker.idle()
    yield made
    made.close()
