"""A panel and a visitor's desk, without a browser, of the robot that a test module names as ROBOT."""

import contextlib

import pytest


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
