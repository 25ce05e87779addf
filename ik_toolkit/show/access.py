"""Controls access to the servers of panel and scene and handles invalid messages, two checks that viser does not make."""

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
# Largest size [bytes] of a message that a page may send. It only sends numbers and short texts, and messages are held in memory
# until complete.
LARGEST = 2**20
# A request that has one of the headers ONCE twice is refused, because the checks might read one of them and the web server the
# other.
ONCE = ("Host", "Origin", "Upgrade", "Accept-Encoding")
LOG = logging.getLogger(__name__)
# Messages of the web socket are not logged, because a port scan would fill the terminal with tracebacks.
QUIET = logging.getLogger(f"{__name__}.socket")
QUIET.setLevel(logging.CRITICAL)
_PATCHING = threading.Lock()


def is_loopback(host: str) -> bool:
    """Return whether a host address is a loopback address, which only programs on this machine can reach."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    """Return a random token (128 bits) to be part of a page's address, so that nobody can guess the address."""
    return secrets.token_urlsafe(16)


def below(path: str, token: str) -> str | None:
    """Check the secret token at the beginning of a request's path; return the rest of the path, or None if the token is wrong.

    The query is left out. The comparison takes constant time, so that it reveals nothing about the token.
    """
    word, slash, rest = path.partition("?")[0].removeprefix("/").partition("/")
    known = secrets.compare_digest(word.encode(errors="backslashreplace"), token.encode())
    return slash + rest if known else None


def refused_request(headers: Any, host: str) -> str:
    """Return the reason for which a web request is refused (other site, other host name, doubled headers), or '' to accept it.

    A browser names the site of the requesting page (header Origin) and the host name it used (header Host); host: the address at
    which the page is served.
    """
    # The method that returns all headers of a name is get_list in tornado and get_all in websockets.
    every = getattr(headers, "get_list", None) or getattr(headers, "get_all", None)
    twice = [name for name in ONCE if every is not None and len(every(name)) > 1]
    if twice:
        return f"this request has more than one header {' and '.join(twice)}"
    asked = headers.get("Host", "")
    name = ""
    # A Host header that is malformed or names two hosts raises ValueError, so `name` stays '' and the request is refused.
    with contextlib.suppress(ValueError):
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
    """Context manager: a server started in the `with` block checks Host, Origin and token, and survives invalid messages.

    Without the check of Origin any web page could connect. Page, files and socket are below /token. A message that
    cannot be read or is too large closes its connection with a reason; a message with invalid values is dropped.
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
                    # Waiting messages would delay the closing of the connection, so they are read and dropped.
                    while True:
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
