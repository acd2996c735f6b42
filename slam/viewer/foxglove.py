"""The topics of the log as a Foxglove WebSocket, for this machine alone.

Foxglove's protocol knows no token, so nobody else is served; `ssh -L 8765:localhost:8765 ROBOT`
brings it to another desk.  Raw bytes have no schema to show and stay in the log.
"""

from __future__ import annotations

import threading
import time
from collections import deque

import foxglove
import numpy as np

from slam.backend.se2 import compose
from slam.logs.foxglove import encode_transform
from slam.logs.messages import Message, OccupancyMap, StatusMessage
from slam.logs.protos import descriptor_set
from slam.logs.schemas import CHANNELS, encode, topic_of
from slam.mapping.slam import Slam
from slam.maps.occupancy import build_map
from slam.runs.errors import ViewError
from slam.viewer.event_cursor import EventCursor
from slam.viewer.snapshot import Snapshot, View

PORT = 8765  # where Foxglove looks by itself

_MOST_WAITING = 2000  # messages; older ones are dropped
_BACKLOG = 1024  # messages of one client
_POLL_S = 0.02
_FRAMES_S = 0.5  # between two transforms for those who came late
_MAP_S = 3.0  # between two maps at least, and ten times as long as one takes


class FoxgloveServer:
    """Encodes and sends in a thread of its own."""

    def __init__(self, port: int = PORT) -> None:
        """Port 0 takes any free one."""
        self.port = port
        self._waiting: deque[Message] = deque(maxlen=_MOST_WAITING)
        self._cursor = EventCursor()
        self._view = View("starting")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._work, name="foxglove", daemon=True)
        self._context = foxglove.Context()
        self._channels = {
            topic: foxglove.Channel(
                topic,
                message_encoding=channel.encoding,
                schema=foxglove.Schema(
                    name=channel.schema_name, encoding="protobuf",
                    data=descriptor_set(channel.message),
                ),
                context=self._context,
            )
            for topic, channel in CHANNELS.items() if channel.message
        }  # fmt: skip
        self._map: OccupancyMap | None = None
        self._grid: OccupancyMap | None = None  # the final map, once it is there
        self._drawn = 0  # keyframes in the map
        self._map_due = self._frames_due = 0.0

    def start(self) -> None:
        """Listen.

        Raises:
            ViewError: the port is taken.
        """
        try:
            self._server = foxglove.start_server(
                name="slam", host="127.0.0.1", port=self.port, context=self._context,
                message_backlog_size=_BACKLOG,
            )  # fmt: skip
        except (OSError, RuntimeError) as error:
            raise ViewError(f"127.0.0.1:{self.port}: no Foxglove server: {error}") from error
        self.port = self._server.port
        self._thread.start()

    def put(self, view: View) -> None:
        """Replace what map and frames are made of."""
        self._view = view

    def put_messages(self, slam: Slam, message: Message) -> None:
        """Queue a message, and what the pipeline has concluded since the last one."""
        self._waiting.append(message)
        self._waiting.extend(self._cursor.take(slam))

    def put_note(self, message: StatusMessage) -> None:
        """Queue a message about a device."""
        self._waiting.append(message)

    def close(self) -> None:
        """Send what waits, and end."""
        self._end.set()
        self._thread.join()
        self._server.stop()

    def _work(self) -> None:
        while not self._end.wait(_POLL_S):
            self._send()
        self._send()

    def _send(self) -> None:
        while self._waiting:
            message = self._waiting.popleft()
            topic = topic_of(message)
            if topic in self._channels:
                self._channels[topic].log(encode(message), log_time=message.stamp_ns)
        view, now = self._view, time.monotonic()
        if view.snapshot is None:
            return
        if now >= self._frames_due:
            self._frames_due = now + _FRAMES_S
            self._send_frames(view.snapshot)
        if now >= self._map_due or view.grid is not self._grid:
            self._send_map(view, view.snapshot)

    def _send_frames(self, snapshot: Snapshot) -> None:
        """Where the robot is in the map, and the laser on the robot."""
        if snapshot.scan is None:
            return
        stamp = snapshot.scan.stamp_ns
        robot = encode_transform(stamp, "map", "base", *snapshot.pose)
        self._channels["/tf"].log(robot, log_time=stamp)
        self._channels["/tf"].log(encode(snapshot.extrinsics), log_time=stamp)

    def _send_map(self, view: View, snapshot: Snapshot) -> None:
        begin = time.monotonic()
        if view.grid is not None:
            self._map = self._grid = view.grid
        elif len(snapshot.keyframes) != self._drawn:
            self._drawn = len(snapshot.keyframes)
            extrinsics = np.array(
                [snapshot.extrinsics.x, snapshot.extrinsics.y, snapshot.extrinsics.theta]
            )
            scans = [keyframe.scan for keyframe in snapshot.keyframes]
            self._map = build_map(scans, compose(snapshot.poses, extrinsics), snapshot.map_config)
        now = time.monotonic()
        self._map_due = now + max(_MAP_S, 10.0 * (now - begin))
        if self._map is not None:
            self._channels["/map"].log(encode(self._map), log_time=self._map.stamp_ns)
