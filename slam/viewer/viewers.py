"""Those who watch a run: a web page, Foxglove, or both."""

from __future__ import annotations

import platform
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from slam.logs.errors import missing_extra
from slam.logs.messages import Message, StatusMessage
from slam.mapping.slam import Slam
from slam.runs.errors import ViewError
from slam.runs.offline import Result
from slam.runs.status import Status
from slam.viewer.access_control import is_local
from slam.viewer.snapshot import View, take, take_result

LEAST_TOKEN = 12  # characters

_PERIOD_S = 0.1  # between two snapshots


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Which viewers a run shall have."""

    page: bool
    address: str
    port: int
    token: str = ""  # made up where one is needed and none is given
    foxglove: bool = False


class Server(Protocol):
    """Shows views in a thread of its own."""

    def put(self, view: View) -> None:
        """Take the newest view; returns at once."""
        ...


class Stream(Protocol):
    """Likewise, message by message."""

    def put_messages(self, slam: Slam, message: Message) -> None:
        """Take a message and what has become of it; returns at once."""
        ...

    def put_note(self, message: StatusMessage) -> None:
        """Take a message about a device; returns at once."""
        ...


class Viewers:
    """A `Observer` that takes a snapshot ten times a second and leaves it where servers find it."""

    def __init__(self) -> None:
        self.seconds = 0.0  # that the pipeline's thread has spent here
        self.steps = 0
        self.servers: list[Server] = []
        self.streams: list[Stream] = []
        self._view, self._due = View("waiting for data"), 0.0

    def show(self, slam: Slam, message: Message) -> None:
        """Look at a pipeline that is done with a message."""
        begin = time.perf_counter()
        for stream in self.streams:
            stream.put_messages(slam, message)
        if begin >= self._due and (snapshot := take(slam)) is not None:
            self._due = begin + _PERIOD_S
            self._put(View("tracking", snapshot, self._view.status))
        self.steps += 1
        self.seconds += time.perf_counter() - begin

    def tell(self, status: Status) -> None:
        """Take the state of the devices."""
        self._put(View(self._view.stage, self._view.snapshot, status))

    def note(self, message: StatusMessage) -> None:
        """Take what is written into the log about a device."""
        for stream in self.streams:
            stream.put_note(message)

    def stage(self, name: str) -> None:
        """Take the name of what is being done."""
        if name != self._view.stage:
            self._put(View(name, self._view.snapshot, self._view.status))

    def finish(self, result: Result) -> None:
        """Take the results."""
        self._put(View("finished", take_result(result), self._view.status, result.grid))

    def _put(self, view: View) -> None:
        self._view = view
        for server in self.servers:
            server.put(view)


@contextmanager
def watched(
    options: ViewOptions, report: Callable[[str], None], needed: bool = True
) -> Iterator[Viewers]:
    """Serve the viewers while the block runs.

    Args:
        options: which.
        report: given where to look.
        needed: whether to fail where the page cannot be served, rather than go on without it.

    Raises:
        ViewError: a viewer cannot be served.
    """
    viewers, closing = Viewers(), list[Callable[[], None]]()
    try:
        if options.page:
            try:
                closing.append(_open_page(options, viewers, report))
            except ViewError as error:
                if needed:
                    raise
                report(f"{error}; going on without it")
        if options.foxglove:
            closing.append(_open_foxglove(viewers, report))
        yield viewers
    finally:
        for close in reversed(closing):
            close()


def _open_page(
    options: ViewOptions, viewers: Viewers, report: Callable[[str], None]
) -> Callable[[], None]:
    try:
        from slam.viewer.server import LiveServer
    except ImportError as error:
        raise ViewError(missing_extra("the live view", "live")) from error
    token = options.token
    if token and len(token) < LEAST_TOKEN:
        raise ViewError(f"no live view: its token must have at least {LEAST_TOKEN} characters")
    if not token and not is_local(options.address):
        token = secrets.token_urlsafe(16)
    page = LiveServer(options.address, options.port, token)
    page.start()
    host = platform.node() if options.address in ("0.0.0.0", "::") else options.address
    host = f"[{host}]" if ":" in host else host
    report(f"live view: http://{host}:{page.port}/{f'?token={token}' if token else ''}")
    viewers.servers.append(page)
    return page.close


def _open_foxglove(viewers: Viewers, report: Callable[[str], None]) -> Callable[[], None]:
    try:
        from slam.viewer.foxglove import FoxgloveServer
    except ImportError as error:
        raise ViewError(missing_extra("--foxglove", "foxglove")) from error
    server = FoxgloveServer()
    server.start()
    report(f"foxglove: open a connection to ws://127.0.0.1:{server.port}")
    viewers.servers.append(server)
    viewers.streams.append(server)
    return server.close
