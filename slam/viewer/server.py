"""The page and its feed over HTTP and WebSocket, in a thread of its own.

The pipeline leaves its newest view in a mailbox that holds one; each page fetches it from there
when it has taken the one before.  So a slow page sees fewer pictures, and a dead one none, and
nobody waits for them.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import threading
from http import HTTPStatus
from pathlib import Path

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from slam.runs.errors import ViewError
from slam.viewer.access_control import AccessControl
from slam.viewer.frames import Feed
from slam.viewer.snapshot import View

PERIOD_S = 0.05  # between two looks for a newer view; those come ten times a second
MOST_PAGES = 12
_SEND_S = 10.0  # a page that takes nothing for so long is given up
_START_S = 10.0
_PAGE = Path(__file__).parent / "page"
_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/view.js": ("view.js", "text/javascript; charset=utf-8"),
    "/map.js": ("map.js", "text/javascript; charset=utf-8"),
    "/panel.js": ("panel.js", "text/javascript; charset=utf-8"),
    "/view.css": ("view.css", "text/css; charset=utf-8"),
}
_OPEN = ("/view.js", "/map.js", "/panel.js", "/view.css")  # tell nothing of the run


class LiveServer:
    """Serves one run until it is closed."""

    def __init__(self, address: str, port: int, token: str = "") -> None:
        """Port 0 takes any free one."""
        self.port = port
        self._address, self._access = address, AccessControl(token)
        self._view = View("starting")
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None
        self._ready = threading.Event()
        self._failure: OSError | None = None
        self._server: Server | None = None
        self._thread = threading.Thread(target=self._work, name="live view", daemon=True)
        self._log = logging.getLogger("slam.viewer")
        self._log.setLevel(logging.CRITICAL)  # broken requests are no news to an operator

    def start(self) -> None:
        """Listen.

        Raises:
            ViewError: the address cannot be used.
        """
        self._thread.start()
        self._ready.wait(_START_S)
        if self._failure is not None:
            raise ViewError(f"{self._address}:{self.port}: no live view: {_reason(self._failure)}")

    def put(self, view: View) -> None:
        """Replace what pages are shown; from any thread, in no time."""
        self._view = view

    def close(self) -> None:
        """Let the pages have the last view, and end."""
        if self._loop is not None and self._end is not None:
            self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(_START_S)

    def _work(self) -> None:
        try:
            asyncio.run(self._listen())
        except OSError as error:
            self._failure = error
        finally:
            self._ready.set()

    async def _listen(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        async with serve(
            self._feed, self._address, self.port, process_request=self._answer, compression=None,
            open_timeout=5, ping_interval=5, ping_timeout=10, close_timeout=1, max_size=1024,
            server_header=None, logger=self._log,
        ) as self._server:  # fmt: skip
            self.port = next(iter(self._server.sockets)).getsockname()[1]
            self._ready.set()
            await self._end.wait()
            await asyncio.sleep(4 * PERIOD_S)

    async def _feed(self, connection: ServerConnection) -> None:
        feed, shown = Feed(), None
        try:
            while connection.state is State.OPEN:
                view = self._view
                if view is not shown:
                    for frame in feed.frames(view):
                        async with asyncio.timeout(_SEND_S):
                            await connection.send(frame)
                    shown = view
                await asyncio.sleep(PERIOD_S)
        except (ConnectionClosed, TimeoutError):
            connection.transport.abort()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """A file, a refusal, or None where the WebSocket may go on."""
        headers, path = request.headers, request.path.partition("?")[0]
        refusal = self._access.refusal(
            request.path, headers.get_all("Host"), headers.get_all("Origin"), path in _OPEN
        )
        if refusal:
            return _response(HTTPStatus.FORBIDDEN, refusal.encode() + b"\n")
        if path in _FILES:
            name, kind = _FILES[path]
            return _response(HTTPStatus.OK, (_PAGE / name).read_bytes(), kind, headers["Host"])
        if path != "/feed":
            return _response(HTTPStatus.NOT_FOUND, b"no such page\n")
        if self._server is not None and len(self._server.connections) >= MOST_PAGES:
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, b"too many pages look already\n")
        return None


def _reason(error: OSError) -> str:
    """What to do about an address that cannot be listened on; asyncio's own words are long."""
    if error.errno == errno.EADDRINUSE:
        return "another program has that port: choose one with --view-port, 0 for any free one"
    if error.errno == errno.EACCES:
        return "no permission for that port: choose one above 1023 with --view-port"
    if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
        return "this machine has no such address: choose one of its own with --view-address"
    return os.strerror(error.errno) if error.errno else str(error)


def _response(
    status: HTTPStatus, body: bytes, kind: str = "text/plain; charset=utf-8", host: str = ""
) -> Response:
    """An answer that no browser keeps, frames, or lets load anything from elsewhere."""
    source = f"'self' ws://{host}" if host else "'none'"
    headers = {
        "Content-Type": kind,
        "Content-Length": str(len(body)),
        "Content-Security-Policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
            f"connect-src {source}; base-uri 'none'; frame-ancestors 'none'"
        ),
        "Cross-Origin-Resource-Policy": "same-origin",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cache-Control": "no-store",
        "Connection": "close",
    }
    return Response(status.value, status.phrase, Headers(headers), body)
