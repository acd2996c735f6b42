"""Loop searches beside the step: the graph cannot tell how fast they were, or where they ran."""

import time
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.world import World

from slam.mapping.loop_worker import run_inline
from slam.mapping.slam import CLOSING_SCANS, Slam
from slam.runs.config_file import load_config

ROOM = World.from_polygon([(-4, -3), (5, -3), (5, 2), (2, 2), (2, 4), (-4, 4)])
SOON = load_config(None, ["loops.min_path_m=2", "loops.every_m=0.4", "loops.target_half=1"])


@pytest.fixture(scope="module")
def circles(sense):
    poses = [Pose2(0.8 * np.sin(0.05 * k), 0.6 - 0.6 * np.cos(0.05 * k), 0.05 * k)
             for k in range(260)]  # fmt: skip
    return sense(ROOM, [*poses[:200], *[poses[200]] * 20, *poses[200:]])  # with a rest


def run(messages, submit=run_inline):
    slam = Slam(SOON, submit=submit)
    for message in messages:
        slam.step(message)
    slam.finish_input()
    return slam


@pytest.fixture(scope="module")
def inline(circles):
    slam = run(circles)
    assert sum(f.kind == "loop" for f in slam.records.factors) >= 5
    return slam


def same(one, other):
    assert one.graph.poses.tobytes() == other.graph.poses.tobytes()
    assert repr(one.records.factors) == repr(other.records.factors)
    assert repr(one.records.estimates) == repr(other.records.estimates)
    assert repr(one.loops.closure_results) == repr(other.loops.closure_results)


@pytest.mark.parametrize("seed", range(3))
def test_a_thread_of_any_speed_gives_the_same_graph(circles, inline, seed):
    rng = np.random.default_rng(seed)

    def late(search, places_to_try):
        time.sleep(rng.choice([0.0, 0.002, 0.03]))
        return search(places_to_try)

    with ThreadPoolExecutor(1) as thread:
        same(run(circles, lambda *work: thread.submit(late, *work)), inline)


class Procrastinated(Future):
    """A search that is begun only when somebody waits for it."""

    def __init__(self, work, seen):
        super().__init__()
        self.work, self.seen, self.begun = work, seen, len(seen())

    def result(self, timeout=None):
        self.waited = len(self.seen()) - self.begun
        search, *arguments = self.work
        return search(*arguments)


def test_a_result_is_waited_for_at_a_scan_that_is_known_beforehand(circles, inline):
    made = []

    def submit(*work):
        made.append(Procrastinated(work, lambda: slam.scans))
        return made[-1]

    slam = Slam(SOON, submit=submit)
    for message in circles:
        slam.step(message)
    slam.finish_input()
    same(slam, inline)
    waits = [future.waited for future in made]
    assert len(waits) > 5
    assert max(waits) == CLOSING_SCANS
    assert min(waits[:-1]) >= 1


def test_a_search_that_fails_is_not_forgotten(circles):
    def submit(*work):
        broken = Future()
        broken.set_exception(ValueError("a defect"))
        return broken

    with pytest.raises(ValueError, match="a defect"):
        run(circles, submit)
