"""What it costs the pipeline to be watched, by nobody, by pages, and by pages that take nothing."""

from __future__ import annotations

import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slam.logs.mcap_log import open_log
from slam.logs.messages import Message
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.runs.offline import Result, run_offline
from slam.runs.replay import SLAM_TOPICS
from slam.tools.imports import import_log
from slam.tools.simulate import simulate_log
from slam.viewer.viewers import Viewers, ViewOptions, watched

_DEAF = 4  # pages at once that take nothing
_HANDSHAKE = (
    "GET /feed HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


@dataclass(frozen=True, slots=True)
class _Case:
    """Who watches."""

    name: str
    page: bool = True
    readers: int = 0
    deaf: int = 0
    foxglove: bool = False


_CASES = (
    _Case("nobody", page=False),
    _Case("served, no page open"),
    _Case("one page", readers=1),
    _Case("four pages that take nothing", readers=1, deaf=_DEAF),
    _Case("Foxglove", page=False, foxglove=True),
)


def bench_view(data: Path | None, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Replay a log with each kind of watcher, as fast as it goes; the result must not change.

    `cpu_s` is that of the pipeline's thread alone, `look_us` what a step spends on the watcher in
    that thread.  The log is intel where `data` has it, else (and with `quick`) a simulated office.
    """
    with tempfile.TemporaryDirectory(prefix="slam-bench-") as scratch:
        log = Path(scratch) / "log.mcap"
        intel = None if data is None else data / "benchmark" / "intel.clf.gz"
        if quick or intel is None or not intel.is_file():
            name = "office"
            simulate_log(name, log, 0, "hokuyo-181", "typical")
        else:
            name = "intel"
            import_log(intel, log)
        with open_log(log) as opened:
            messages = list(opened.messages(SLAM_TOPICS))
    _run(messages[:200], Viewers())  # kernels are compiled
    rows: list[dict[str, Any]] = []
    alone: Result | None = None
    for case in _CASES:
        echo(f"{name}: watched by {case.name}")
        row, result = _measure(case, messages)
        alone = alone or result
        rows.append({"log": name, **row, "identical": _same(alone, result)})
    return {"meta": {"log": name, "messages": len(messages)}, "rows": rows}


def _measure(case: _Case, messages: list[Message]) -> tuple[dict[str, Any], Result]:
    options = ViewOptions(case.page, "127.0.0.1", 0, foxglove=case.foxglove)
    said: list[str] = []
    with watched(options, said.append) as viewers, ExitStack() as visits:
        port = int(said[0].rstrip("/").rpartition(":")[2]) if case.page else 0
        frames = [visits.enter_context(_reader(port)) for _ in range(case.readers)]
        for _ in range(case.deaf):
            visits.enter_context(_deaf(port))
        wall, cpu = time.perf_counter(), time.thread_time()
        result = _run(messages, viewers)
        wall, cpu = time.perf_counter() - wall, time.thread_time() - cpu
    return {
        "watched_by": case.name,
        "cpu_s": round(cpu, 3),
        "wall_s": round(wall, 3),
        "look_us": round(1e6 * viewers.seconds / max(viewers.steps, 1), 2),
        "look_share": round(viewers.seconds / wall, 5),
        "frames": sum(count[0] for count in frames),
    }, result


def _run(messages: list[Message], viewers: Viewers) -> Result:
    def step(slam: Slam, message: Message) -> None:
        slam.step(message)
        viewers.show(slam, message)

    config = SlamConfig()
    fast = config.localise.model_copy(update={"every_scan": False})
    result = run_offline(lambda: messages, config.model_copy(update={"localise": fast}), step=step)
    viewers.finish(result)
    return result


def _same(a: Result, b: Result) -> bool:
    equal = a.trajectory.poses.tobytes() == b.trajectory.poses.tobytes()
    return equal and a.slam.records.factors == b.slam.records.factors and a.estimates == b.estimates


@contextmanager
def _reader(port: int) -> Iterator[list[int]]:
    """A page that takes every frame; gives their count."""
    count = [0]
    with connect(f"ws://127.0.0.1:{port}/feed", proxy=None, close_timeout=0.1) as feed:

        def read() -> None:
            try:
                while True:
                    feed.recv()
                    count[0] += 1
            except ConnectionClosed:
                pass

        thread = threading.Thread(target=read, daemon=True)
        thread.start()
        yield count


@contextmanager
def _deaf(port: int) -> Iterator[None]:
    """A page that asks and then takes nothing."""
    with socket.create_connection(("127.0.0.1", port)) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.sendall(_HANDSHAKE.format(port=port).encode())
        yield
