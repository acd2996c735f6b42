"""Watching changes nothing, and what cannot be watched is said."""

import sys

import numpy as np
import pytest
from websockets.sync.client import connect

from slam.runs.errors import ViewError
from slam.viewer import viewers as module
from slam.viewer.viewers import ViewOptions, watched


def options(**values) -> ViewOptions:
    return ViewOptions(**({"page": True, "address": "127.0.0.1", "port": 0} | values))


def test_a_watched_run_is_the_same_run_bit_for_bit(drive):
    said = []
    with watched(options(foxglove=True), said.append) as viewers:
        address = said[0].removeprefix("live view: http").removesuffix("/")
        with connect(f"ws{address}/feed", proxy=None, close_timeout=0.1):
            result = drive.run(viewers)
    alone = drive.result
    assert viewers.steps == len(drive.messages)
    assert np.array_equal(result.trajectory.poses, alone.trajectory.poses)
    assert np.array_equal(result.keyframes.poses, alone.keyframes.poses)
    assert result.slam.records.factors == alone.slam.records.factors
    assert result.estimates == alone.estimates
    assert np.array_equal(result.grid.cells, alone.grid.cells)


def test_what_is_shown_at_the_end_is_the_result(drive):
    views = []

    class Server:
        def put(self, view):
            views.append(view)

    with watched(options(page=False), print) as viewers:
        viewers.servers.append(Server())
        viewers.stage("tracking")
        result = drive.run(viewers)
        viewers.finish(result)
    assert views[0].stage == "tracking"
    assert views[-1].stage == "finished"
    assert np.array_equal(views[-1].snapshot.poses, result.keyframes.poses)
    shown = [view.snapshot for view in views if view.snapshot is not None]
    assert [len(s.keyframes) for s in shown] == sorted(len(s.keyframes) for s in shown)


def test_a_taken_port_ends_what_needs_the_page_and_not_what_does_not():
    said = []
    with watched(options(), said.append):
        port = int(said[0].rstrip("/").rpartition(":")[2])
        with pytest.raises(ViewError, match="no live view"), watched(options(port=port), print):
            pass
        with watched(options(port=port), said.append, needed=False) as viewers:
            assert viewers.servers == []
    assert said[-1].endswith("going on without it")


def test_another_address_gets_a_token(monkeypatch):
    monkeypatch.setattr(module, "is_local", lambda address: False)
    said = []
    with watched(options(), said.append), watched(options(), said.append):
        pass
    tokens = {line.partition("?token=")[2] for line in said}
    assert len(tokens) == 2  # each its own
    assert all(len(token) >= 20 for token in tokens)
    with watched(options(token="chosen by the operator"), said.append):
        assert said[-1].endswith("/?token=chosen by the operator")
    with pytest.raises(ViewError, match="12 characters"), watched(options(token="short"), print):
        pass


@pytest.mark.parametrize(
    ("library", "ours", "extra"),
    [("websockets.asyncio.server", "server", "live"), ("foxglove", "foxglove", "foxglove")],
)
def test_a_missing_library_is_named_with_its_extra(monkeypatch, library, ours, extra):
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"slam.viewer.{ours}", raising=False)
    wanted = options(page=extra == "live", foxglove=extra == "foxglove")
    with pytest.raises(ViewError, match=rf"sdp-slam\[{extra}\]"), watched(wanted, print):
        pass
