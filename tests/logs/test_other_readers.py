"""Our files in the hands of independent programs, and one of theirs in ours."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.stream_reader import StreamReader
from slam.logs import protos
from slam.logs.mcap_log import open_log
from slam.logs.messages import LaserScan
from slam.logs.recompress import recompress
from slam.logs.recorder import Recorder
from slam.logs.recording import RecorderConfig
from slam.logs.recover import recover

from tests.logs.golden.make_golden import golden_messages

SCRIPT = Path(__file__).with_name("read_with_mcap_core.mjs")
NPM_SECONDS = 60


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    """Return a log as recorded, one recompressed, and one recovered from a cut."""
    folder = tmp_path_factory.mktemp("logs")
    recorded = folder / "recorded.mcap"
    config = RecorderConfig(recompress=False)
    with Recorder(recorded, {"id": "1"}, config) as recorder:
        recorder.add_metadata("laser", {"serial": "H1"})
        recorder.add_attachment("config.toml", b"a = 1", "application/toml")
        for message in sorted(golden_messages(), key=lambda m: m.stamp_ns):
            recorder.put(message)
    recompressed = folder / "recompressed.mcap"
    shutil.copy(recorded, recompressed)
    recompress(recompressed)
    (folder / "cut.mcap").write_bytes(recorded.read_bytes()[:-200])
    recovered = folder / "recovered.mcap"
    recover(folder / "cut.mcap", recovered)
    return {"recorded": recorded, "recompressed": recompressed, "recovered": recovered}


def counts(path: Path) -> dict[str, int]:
    with open_log(path) as log:
        return {topic: n for topic, n in log.counts().items() if n}


KINDS = ["recorded", "recompressed", "recovered"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_mcap_package_reads_them_with_all_checks(files, kind: str):
    path, wanted = files[kind], counts(files[kind])
    assert sum(wanted.values()) == len(golden_messages())
    with path.open("rb") as file:
        streamed = StreamReader(file, validate_crcs=True, emit_chunks=False).records
        kinds = Counter(type(record).__name__ for record in streamed)
    assert kinds["Message"] == sum(wanted.values())
    assert kinds["Attachment"] == 1
    for reader_class in (SeekingReader, NonSeekingReader):
        with path.open("rb") as file:
            reader = reader_class(file, validate_crcs=True)
            read = Counter(channel.topic for _, channel, _ in reader.iter_messages())
            assert read == wanted
    with path.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        assert [a.name for a in reader.iter_attachments()] == ["config.toml"]
        assert "laser" in {m.name for m in reader.iter_metadata()}


@pytest.fixture(scope="module")
def mcap_core(tmp_path_factory) -> Path:
    """Install @mcap/core in a folder of its own and return the script beside it."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("node")
    install = ["npm", "install", "--no-audit", "--no-fund", "@mcap/core@2", "fzstd@0.1"]
    try:
        done = subprocess.run(install, cwd=folder, capture_output=True, timeout=NPM_SECONDS)
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm did not answer within {NPM_SECONDS} s")
    if done.returncode:
        pytest.skip(f"npm cannot install @mcap/core: {done.stderr.decode()[-200:]}")
    return Path(shutil.copy(SCRIPT, folder))


@pytest.mark.parametrize("kind", KINDS)
def test_mcap_core_reads_them_with_all_checks(files, mcap_core: Path, kind: str):
    done = subprocess.run(
        ["node", str(mcap_core), str(files[kind])], capture_output=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    found = json.loads(done.stdout)
    wanted = counts(files[kind])
    for way in ("streamed", "indexed"):
        assert found[way]["messages"] == wanted
        assert found[way]["attachments"] == ["config.toml"]
    assert found["streamed"]["dataEnd"] == 1
    assert {"run", "laser"} <= set(found["streamed"]["metadata"])


def test_a_scan_written_by_the_foxglove_sdk_is_read_by_us(tmp_path: Path):
    """The SDK has a writer only (0.30), so it can be held against our reader alone."""
    foxglove = pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    from foxglove.channels import LaserScanChannel
    from foxglove.messages import LaserScan as FoxgloveScan
    from foxglove.messages import Timestamp

    context = foxglove.Context()
    channel = LaserScanChannel("/scan", context=context)
    with foxglove.open_mcap(str(tmp_path / "a.mcap"), context=context):
        for k in range(5):
            channel.log(
                FoxgloveScan(
                    timestamp=Timestamp(100 + k), frame_id="laser", start_angle=-1.0,
                    end_angle=1.0, ranges=[1.0, 2.0, 3.0], intensities=[],
                ),
                log_time=(100 + k) * 10**9,
            )  # fmt: skip
    with open_log(tmp_path / "a.mcap") as log:
        scans = list(log.messages())
        assert not log.skipped
    assert [type(s) for s in scans] == [LaserScan] * 5
    assert (scans[0].angle_min, scans[0].angle_step) == pytest.approx((-1.0, 1.0))
    assert scans[0].ranges.tolist() == pytest.approx([1.0, 2.0, 3.0])
    assert np.diff([s.stamp_ns for s in scans]).tolist() == [10**9] * 4


def test_the_foxglove_sdk_knows_every_field_of_our_standard_channels_by_the_same_number():
    """All but our own field, which lies beyond theirs."""
    messages = pytest.importorskip("foxglove.messages", reason="foxglove-sdk is not installed")
    for name in ("LaserScan", "FrameTransform", "Grid", "Log", "Odometry"):
        theirs = fields_of(getattr(messages, name).get_schema().data, name)
        ours = fields_of(protos.descriptor_set(name), name)
        assert {k: v for k, v in ours.items() if k < protos.OUR_FIELD} == theirs
        assert ours.keys() - theirs.keys() <= {protos.OUR_FIELD}


def fields_of(data: bytes, name: str) -> dict[int, tuple[str, int, str]]:
    files = FileDescriptorSet.FromString(data).file
    (message,) = (m for f in files if f.package == "foxglove" for m in f.message_type
                  if m.name == name)  # fmt: skip
    return {f.number: (f.name, f.type, f.type_name) for f in message.field}
