"""The topics of the log, as a Foxglove client sees them."""

import contextlib
import json
import struct
import time
from collections.abc import Callable

import pytest
from slam.logs.messages import DeviceHealth, LaserExtrinsics, LogLine
from slam.logs.schemas import CHANNELS, decode
from websockets.sync.client import connect

from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.runs.errors import ViewError
from slam.viewer.foxglove import FoxgloveServer
from slam.viewer.viewers import Viewers

PROTOCOL = "foxglove.sdk.v1"
PATIENCE_S = 60.0


class Client:
    """Subscribes to all that is offered; keeps what comes, by topic."""

    def __init__(self, socket) -> None:
        self.topics: dict[int, str] = {}
        self.schemas: dict[str, str] = {}
        self.got: dict[str, list[tuple[int, bytes]]] = {}
        self._socket = socket

    def take(self, timeout_s: float) -> None:
        """Take one frame, or none if none comes in time."""
        with contextlib.suppress(TimeoutError):
            data = self._socket.recv(timeout=timeout_s)
            if isinstance(data, str):
                for channel in json.loads(data).get("channels", ()):
                    self.topics[channel["id"]] = channel["topic"]
                    self.schemas[channel["topic"]] = channel["schemaName"]
            elif data[0] == 1:
                _, channel, stamp_ns = struct.unpack_from("<BIQ", data)
                self.got.setdefault(self.topics[channel], []).append((stamp_ns, bytes(data[13:])))

    def wait(self, enough: Callable[[], bool], ask: Callable[[], None] = lambda: None) -> None:
        end = time.monotonic() + PATIENCE_S
        while not enough():
            assert time.monotonic() < end, f"only {sorted(self.got)} came"
            ask()
            self.take(0.1)

    def subscribe(self) -> None:
        wanted = [{"id": k, "channelId": k} for k in self.topics]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@pytest.fixture
def server():
    foxglove = FoxgloveServer(0)
    foxglove.start()
    yield foxglove
    foxglove.close()


def test_a_client_gets_the_topics_of_the_log_with_their_schemas(drive, server):
    viewers = Viewers()
    viewers.servers.append(server)
    viewers.streams.append(server)
    schemas = {t: channel.schema_name for t, channel in CHANNELS.items() if channel.message}
    with connect(
        f"ws://127.0.0.1:{server.port}", subprotocols=[PROTOCOL], proxy=None, close_timeout=0.1,
        max_queue=None,
    ) as socket:  # fmt: skip
        client = Client(socket)
        client.wait(lambda: client.schemas.keys() >= schemas.keys())
        client.subscribe()
        extrinsics = LaserExtrinsics(
            1, 0.0, 0.0, 0.0
        )  # until the subscription is known on the other side
        client.wait(
            lambda: bool(client.got), lambda: server.put_messages(Slam(SlamConfig()), extrinsics)
        )
        result = drive.run(viewers)
        viewers.finish(result)
        viewers.note(LogLine(2, "warning", "laser", "lost: no reply"))
        viewers.note(DeviceHealth(3, "laser", "lost", ("outages",), ("1",)))
        needed = schemas.keys() - {"/loop"}  # the test bed has none
        client.wait(lambda: client.got.keys() >= needed)
    assert client.schemas == schemas
    stamp_ns, payload = client.got["/scan"][0]
    assert decode("/scan", stamp_ns, payload).stamp_ns == stamp_ns
    assert (decode("/map", *client.got["/map"][-1]).cells >= 0).any()


def test_a_port_that_is_taken_is_one_clear_line(server):
    with pytest.raises(ViewError, match=f"{server.port}: no Foxglove server"):
        FoxgloveServer(server.port).start()
