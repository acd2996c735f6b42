"""The topics of the log, as a Foxglove client sees them."""

import json
import struct

from websockets.sync.client import connect

from logs.schemas import CHANNELS, decode
from slam.live.foxglove import FoxgloveServer
from slam.live.viewers import Viewers

PROTOCOL = "foxglove.sdk.v1"


def test_a_client_gets_the_topics_of_the_log_with_their_schemas(drive):
    server, viewers = FoxgloveServer(0), Viewers()
    server.start()
    viewers.servers.append(server)
    viewers.streams.append(server)
    wanted = {topic for topic, channel in CHANNELS.items() if channel.message}
    topics, got = {}, {}
    try:
        with connect(
            f"ws://127.0.0.1:{server.port}", subprotocols=[PROTOCOL], proxy=None, close_timeout=0.1
        ) as client:
            while set(topics.values()) < wanted:
                advertised = json.loads(client.recv(timeout=5))
                for channel in advertised.get("channels", ()):
                    topics[channel["id"]] = channel["topic"]
                    assert channel["schemaName"] == CHANNELS[channel["topic"]].schema_name
            client.send(
                json.dumps(
                    {
                        "op": "subscribe",
                        "subscriptions": [{"id": k, "channelId": k} for k in topics],
                    }
                )
            )
            result = drive.run(viewers)
            viewers.finish(result)
            needed = wanted - {"/loop"}  # the test bed has none
            while set(got) < needed:
                data = client.recv(timeout=10)
                if isinstance(data, str) or data[0] != 1:
                    continue
                _, channel, stamp_ns = struct.unpack_from("<BIQ", data)
                payload = bytes(data[13:])
                got.setdefault(topics[channel], []).append((stamp_ns, payload))
    finally:
        server.close()
    stamp_ns, payload = got["/scan"][0]
    assert decode("/scan", stamp_ns, payload).stamp_ns == stamp_ns
    grid = decode("/map", *got["/map"][-1])
    assert (grid.cells >= 0).any()
