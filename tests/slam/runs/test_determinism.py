"""One recorded drive, replayed ten times in processes of their own: the same run every time."""

import hashlib
import os
import subprocess
import sys
import time

import pytest
from slam.logs.mcap_log import open_log
from slam.logs.schemas import encode, topic_of

from slam.runs.config_file import load_config
from slam.tools.demo.drive import drive_online

RESULTS = ("/keyframe", "/factor", "/loop", "/pose", "/map")
FILES = ("trajectory.tum", "keyframes.tum", "odometry.tum", "graph.g2o", "map.pgm")


def fingerprints(run):
    """SHA-256 of every kind of result."""
    digests = {name: hashlib.sha256((run / name).read_bytes()).hexdigest() for name in FILES}
    sums = {topic: hashlib.sha256() for topic in RESULTS}
    with open_log(run / "run.mcap") as log:
        for message in log.messages(RESULTS):
            sums[topic_of(message)].update(message.stamp_ns.to_bytes(8) + encode(message))
    return digests | {topic: digest.hexdigest() for topic, digest in sums.items()}


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_ten_replays_paced_and_not_from_decoded_and_raw_are_the_run_itself(tmp_path):
    echo = print  # figures, shown by `pytest -s`
    drive_online(tmp_path, load_config(None), echo)
    online = fingerprints(tmp_path / "online")
    for k in range(10):
        source, rate = ("decoded", "raw")[k % 2], ("0", "0", "1", "1", "5")[k // 2]
        out, began = tmp_path / f"again-{k}", time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "slam", "replay", str(tmp_path / "online" / "run.mcap"),
             "--config", str(tmp_path / "online" / "slam.toml"), "--out", str(out),
             "--from", source, "--rate", rate],
            env=os.environ | {"PYTHONHASHSEED": str(k), "OMP_NUM_THREADS": str(1 + k % 2)},
        )  # fmt: skip
        assert done.returncode in (0, 3)  # 3: of a busy machine's recording something is missing
        echo(f"replay {k}: {source}, rate {rate}, {time.monotonic() - began:.1f} s")
        assert fingerprints(out) == online, (source, rate)
    for name, digest in online.items():
        echo(f"{name:<16} {digest}")
