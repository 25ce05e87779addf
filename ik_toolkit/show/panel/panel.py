"""The panel: drive a robot by hand in a browser, with sliders, pose, target and solver.

Every visitor has their own robot (a Session) and one worker thread that runs their requests, newest first, so that drags
never queue up and visitors do not disturb each other.
"""

import contextlib
import errno
import http.client
import io
import socket
import warnings
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from ...copying import Unique
from ...errors import InvalidOption, MissingExtra
from ..access import guarded, is_loopback, new_token
from .page import PanelPage
from .session import Session

# names of the viser messages that are accepted from a visitor's page: controls, handles of the target, camera
HEARD = (
    "GuiUpdateMessage",
    "TransformControlsUpdateMessage",
    "TransformControlsDragStartMessage",
    "TransformControlsDragEndMessage",
    "SceneNodeDragMessage",
    "ViewerCameraMessage",
)


class Follower(PanelPage):
    """The page of `ik view --follow`: the 3-D view, fields to type targets, and a status line."""

    def _build_controls(self) -> None:
        self.sliders: list[Any] = []
        self.status = self.gui.add_html("")
        self._build_goals()
        self._button("Reset to home", "joints", self._home, color=None)
        self.outcome = self.gui.add_html("", visible=False)
        self.pose = self.gui.add_html("")


class Panel(Unique):
    """The panel's server; `url` is its address with the access token, and `close()` stops it.

    Several browsers may be open.
    """

    def __init__(
        self,
        source: str,
        tips: str | Sequence[str] | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        desk: type[PanelPage] = PanelPage,
    ) -> None:
        """Serve a robot given by name or path.

        tips: one or several, by default all known ones; port 0 takes a free port; desk: class of the page that each visitor
        sees. Raises MissingExtra without viser, InvalidOption if it cannot listen there, and what loading a robot raises.
        """
        try:
            import viser
        except ImportError:
            raise MissingExtra("viser", "panel") from None
        _check_address(host, port)
        # viser warns of messages to a closed connection whenever a visitor leaves, which is normal
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
        session = Session(source, tips)  # an invalid robot raises its error here
        here = session.robot.for_tips(session.poses())
        session.solve(here)  # compiles if necessary, so that no visitor has to wait
        session.follow(here)
        token = new_token()
        # stdout is redirected to suppress viser's banner
        with guarded(host, token), contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self.host, self.port = host, self.server.get_port()
        if port not in (0, self.port):
            self.close()
            raise InvalidOption(f"port {port} is in use")
        name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104  compared, not bound
        self.url = f"http://{f'[{name}]' if ':' in name else name}:{self.port}/{token}/"
        self._check_guard()
        # The controls shared by all visitors accept no messages; those of a single visitor's page do.
        _hear_only(self.server.gui._websock_interface, ())
        self.desks: dict[int, PanelPage] = {}
        self._desk = desk
        self.server.gui.set_panel_label("ik panel")
        local = is_loopback(host)
        self.server.on_client_connect(lambda client: self._welcome(client, source, tips, local))
        self.server.on_client_disconnect(lambda client: self._goodbye(client))

    def _welcome(self, client: Any, source: str, tips: str | Sequence[str] | None, local: bool) -> None:
        _hear_only(client.gui._websock_interface, HEARD)
        self.desks[client.client_id] = self._desk(client, source, tips, files=local)
        if client.client_id not in self.server.get_clients():  # the visitor left before being admitted
            self._goodbye(client)

    def _goodbye(self, client: Any) -> None:
        desk = self.desks.pop(client.client_id, None)
        if desk is not None:
            desk.close()

    def _check_guard(self) -> None:
        """Check that requests from other sites or without the token are refused; do not serve if this viser answers them."""
        at = urlsplit(self.url)
        for path, headers in ((at.path, {"Origin": "http://elsewhere.invalid"}), ("/", {})):
            client = http.client.HTTPConnection(at.hostname or "", self.port, timeout=10)
            try:
                client.request("GET", path, headers=headers)
                refused = client.getresponse().status == http.client.FORBIDDEN
            finally:
                client.close()
            if not refused:
                self.close()
                raise InvalidOption("this release of viser answers unauthorised requests, so the panel is not served")

    def close(self) -> None:
        """Stop serving and end the visitors' threads."""
        for desk in list(getattr(self, "desks", {}).values()):
            desk.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def _check_address(host: str, port: int) -> None:
    """Reject an address that cannot be listened on, because viser would try one port after another for ever."""
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InvalidOption(f"port {port} is in use") from None
        at = f"{host}, port {port}" if port else host
        raise InvalidOption(f"cannot listen on {at}: {error.strerror or error}") from None


def _hear_only(interface: Any, names: tuple[str, ...]) -> None:
    """Accept only some kinds of message from a page, because viser would store files, broadcast form values and open tunnels."""
    for kind in list(interface._incoming_handlers):
        if kind.__name__ not in names:
            interface.unregister_handler(kind)
