"""Access control for the servers of panel and scene, and handling of invalid messages: checks that viser does not make."""

import asyncio
import contextlib
import http.client
import ipaddress
import logging
import secrets
import threading
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

LOOPBACK = ("127.0.0.1", "localhost", "::1")
LARGEST = 2**20  # bytes per message: the page sends numbers and short texts, and messages are buffered until complete
ONCE = ("Host", "Origin", "Upgrade", "Accept-Encoding")  # headers of which viser and the checks here read the only one
LOG = logging.getLogger(__name__)
QUIET = logging.getLogger(f"{__name__}.socket")  # a port scan would fill the terminal with handshake tracebacks
QUIET.setLevel(logging.CRITICAL)
_PATCHING = threading.Lock()


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine can reach a host address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    """Token of 128 random bits in a page's address; nothing is served without it."""
    return secrets.token_urlsafe(16)


def below(path: str, token: str) -> str | None:
    """Part of a request's path below /token, without its query; None if it does not start with the token.

    Compares in constant time.
    """
    word, slash, rest = path.partition("?")[0].removeprefix("/").partition("/")
    known = secrets.compare_digest(word.encode(errors="backslashreplace"), token.encode())
    return slash + rest if known else None


def refused_request(headers: Any, host: str) -> str:
    """Why a request is refused, or ''. A browser sends the requesting page (Origin) and the host name it used (Host)."""
    every = getattr(headers, "get_list", None) or getattr(headers, "get_all", None)  # of tornado, of websockets
    twice = [name for name in ONCE if every is not None and len(every(name)) > 1]
    if twice:
        return f"this request has more than one header {' and '.join(twice)}"
    asked = headers.get("Host", "")
    name = ""
    with contextlib.suppress(ValueError):  # also two hosts in one header: no port is a number then
        split = urlsplit(f"//{asked}")
        name = (split.hostname or "") if split.port is None or split.port else ""
    if is_loopback(host) and name not in LOOPBACK and name != host:
        return f"this page is served at {host} only, not as '{name}'"
    origin = headers.get("Origin")
    if origin is not None and origin.partition("://")[2] != asked:
        return "requests from other sites are refused"
    return ""


@contextlib.contextmanager
def guarded(host: str, token: str) -> Iterator[None]:
    """Make the server started inside check Host, Origin (any web page could connect otherwise) and token, and survive bad input.

    Page, files and socket are below /token. A message that cannot be read or is too large closes its connection with a reason;
    one that makes no sense is dropped.
    """
    import websockets.asyncio.server as ws
    from websockets.exceptions import ConnectionClosed

    original = ws.serve

    def serve(talk: Any, *args: Any, process_request: Callable[[Any, Any], Any] | None = None, **kwargs: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            words = refused_request(request.headers, host)
            path = below(request.path, token)
            if words or path is None:
                return connection.respond(http.client.FORBIDDEN, f"{words or 'this is not the whole address'}\n")
            request.path = path or "/"
            return process_request(connection, request) if process_request is not None else None

        async def bear(connection: Any) -> None:
            asyncio.get_running_loop().set_exception_handler(_drop)
            try:
                await talk(connection)
            except Exception as error:
                LOG.info("unreadable message: %r", error)
                closing = asyncio.create_task(connection.close(1007, "this is not a message of the panel's page"))
                with contextlib.suppress(ConnectionClosed):
                    while True:  # drain pending messages, which would hold up the closing frame
                        await connection.recv()
                await closing

        return original(bear, *args, process_request=check, **{**kwargs, "max_size": LARGEST, "logger": QUIET})

    with _PATCHING:
        ws.serve = serve  # type: ignore[assignment]
        try:
            yield
        finally:
            ws.serve = original


def _drop(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    if context.get("exception") is None:
        loop.default_exception_handler(context)
    else:
        LOG.info("invalid message: %r", context["exception"])
