"""A drive through the test bed, its run, and a server to show it."""

from dataclasses import dataclass

import pytest
from slam.drivers.simulators.drive import paper_drive

from slam.runs.config_file import load_config
from slam.runs.offline import Result, run_offline
from slam.viewer.server import LiveServer
from slam.viewer.snapshot import Snapshot, View, take_result
from slam.viewer.viewers import Viewers


@dataclass
class Drive:
    messages: list
    config: object
    result: Result

    def run(self, viewers: Viewers) -> Result:
        def step(slam, message):
            slam.step(message)
            viewers.show(slam, message)

        return run_offline(lambda: self.messages, self.config, step=step)


@pytest.fixture(scope="session")
def drive() -> Drive:
    config = load_config(None, ["keyframes.method=sdp-pe", "localise.every_scan=false"])
    messages = list(paper_drive("180cm"))
    return Drive(messages, config, run_offline(lambda: messages, config))


@pytest.fixture(scope="session")
def snapshot(drive) -> Snapshot:
    return take_result(drive.result)


@pytest.fixture
def server(snapshot):
    live = LiveServer("127.0.0.1", 0)
    live.start()
    live.put(View("tracking", snapshot))
    yield live
    live.close()
