"""The server as browsers, programs and bad neighbours see it."""

import http.client
import json
import socket
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync import client

from slam.runs.errors import ViewError
from slam.viewer.server import MOST_PAGES, LiveServer
from slam.viewer.snapshot import View

TOKEN = "a-token-of-the-operator"


def connect(address: str, **settings):
    """A feed whose end does not wait for what is still under way."""
    return client.connect(address, proxy=None, close_timeout=0.1, **settings)


def get(port: int, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


def states(feed, wanted) -> dict:
    """Read until a state is as wanted."""
    while True:
        frame = json.loads(feed.recv(timeout=5))
        if frame["type"] == "state" and wanted(frame):
            return frame


def test_the_page_and_its_parts_are_served_and_load_nothing_from_elsewhere(server):
    for path in ("/", "/view.js", "/map.js", "/panel.js", "/view.css"):
        status, headers, body = get(server.port, path)
        assert status == 200
        assert b"https://" not in body.replace(b"http://www.w3.org", b"")
        policy = headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert f"connect-src 'self' ws://127.0.0.1:{server.port};" in policy
        assert headers["Cache-Control"] == "no-store"
    assert get(server.port, "/../server.py")[0] == 404
    assert get(server.port, "/feed")[0] in (400, 426)  # no page: a WebSocket


def test_foreign_origins_and_names_are_refused(server):
    feed = f"ws://127.0.0.1:{server.port}/feed"
    with pytest.raises(InvalidStatus, match="403"), connect(feed, origin="http://evil.example"):
        pass
    assert get(server.port, "/", Host="evil.example:8321")[0] == 403
    assert get(server.port, "/feed", Host="evil.example:8321")[0] == 403
    with connect(feed, origin=f"http://127.0.0.1:{server.port}") as allowed:
        assert json.loads(allowed.recv(timeout=5)) == {"type": "hello"}


def test_a_token_is_asked_for_where_there_is_one():
    live = LiveServer("127.0.0.1", 0, TOKEN)
    live.start()
    try:
        feed = f"ws://127.0.0.1:{live.port}/feed"
        assert get(live.port, "/")[0] == 403
        assert get(live.port, f"/?token={TOKEN}")[0] == 200
        assert get(live.port, "/view.css")[0] == 200
        for wrong in (feed, f"{feed}?token=guess"):
            with pytest.raises(InvalidStatus, match="403"), connect(wrong):
                pass
        with connect(f"{feed}?token={TOKEN}") as allowed:
            assert json.loads(allowed.recv(timeout=5)) == {"type": "hello"}
    finally:
        live.close()


def test_a_page_follows_the_run(server, snapshot):
    with connect(f"ws://127.0.0.1:{server.port}/feed") as feed:
        states(feed, lambda s: s["stage"] == "tracking")
        server.put(View("finishing the map", replace(snapshot, scans=7)))
        assert states(feed, lambda s: s["stage"] == "finishing the map")["scans"] == 7


def test_a_page_that_takes_nothing_holds_up_neither_the_run_nor_other_pages(server, snapshot):
    request = (
        f"GET /feed HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n"
    )
    deaf = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(4)]
    try:
        for sock in deaf:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            sock.sendall(request.encode())
        slowest = 0.0
        with connect(f"ws://127.0.0.1:{server.port}/feed") as feed:
            for k in range(30):
                far = replace(snapshot, poses=snapshot.poses + np.array([k, 0.0, 0.0]), scans=k)
                begin = time.perf_counter()
                server.put(View("tracking", far))
                slowest = max(slowest, time.perf_counter() - begin)
                time.sleep(0.02)
            assert states(feed, lambda s: s["scans"] == 29)
        assert slowest < 0.05
    finally:
        for sock in deaf:
            sock.close()


def test_more_pages_than_anyone_needs_are_turned_away(server):
    address = f"ws://127.0.0.1:{server.port}/feed"
    with ExitStack() as feeds:
        for _ in range(MOST_PAGES):
            feeds.enter_context(connect(address))
        with pytest.raises(InvalidStatus, match="503"), connect(address):
            pass
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:  # those that left make room
        with suppress(InvalidStatus), connect(address):
            return
    pytest.fail("no room again")


def test_a_port_that_is_taken_is_one_clear_line_and_no_thread_is_left(server):
    before = threading.active_count()
    with pytest.raises(ViewError, match=rf"127\.0\.0\.1:{server.port}: no live view: "):
        LiveServer("127.0.0.1", server.port).start()
    time.sleep(0.1)
    assert threading.active_count() == before


def test_garbage_is_no_news(server, capfd):
    with socket.create_connection(("127.0.0.1", server.port)) as sock:
        sock.sendall(b"\x16\x03\x01 nonsense\r\n\r\n")
        sock.recv(1000)
    assert get(server.port, "/")[0] == 200
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("address", "words"), [("127.0.0.1", "--view-port"), ("192.0.2.1", "--view-address")]
)
def test_an_address_that_cannot_be_had_is_told_in_words_that_help(address, words):
    first = LiveServer("127.0.0.1", 0)
    first.start()
    try:
        with pytest.raises(ViewError, match=words) as error:
            LiveServer(address, first.port).start()
        assert "attempting" not in str(error.value)
    finally:
        first.close()
