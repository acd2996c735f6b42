"""The description of our messages that people read is the one that is loaded."""

import hashlib
from pathlib import Path

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from slam.logs import protos
from slam.logs.messages import KeyframeDecision
from slam.logs.schemas import decode, encode

LOGS = Path(protos.__file__).parent
GOLDEN = Path(__file__).parent / "golden" / "schema1-devices.mcap"


def test_the_compiled_form_is_that_of_the_source(tmp_path):
    protoc = pytest.importorskip("grpc_tools.protoc")
    found = tmp_path / "slam.binpb"
    protoc.main(["", f"-I{LOGS}", f"--descriptor_set_out={found}", str(LOGS / "slam.proto")])
    compiled = (LOGS / "slam.binpb").read_bytes()
    assert FileDescriptorSet.FromString(found.read_bytes()) == FileDescriptorSet.FromString(
        compiled
    )


def test_schemas_are_those_that_older_logs_hold():
    with GOLDEN.open("rb") as file:
        summary = make_reader(file).get_summary()
    stored = {schema.name: schema.data for schema in summary.schemas.values()}
    names = [*protos.CLASSES]
    assert stored.keys() == {protos.full_name(name) for name in names}
    for name in names:
        if name != "KeyframeDecision":  # it has had one field appended
            assert protos.descriptor_set(name) == stored[protos.full_name(name)]
    (old,) = FileDescriptorSet.FromString(stored["slam.v1.KeyframeDecision"]).file
    (new,) = FileDescriptorSet.FromString(protos.descriptor_set("KeyframeDecision")).file
    assert new.message_type[0].field.pop().name == "predicted_sigmas"
    assert new == old


def test_messages_without_a_new_field_are_written_as_before():
    old = KeyframeDecision(7, 1, 20, "turn", "x", 0.5, 0.1, 0.5, 0.7, (1.0, 2.0, 3.0, 4.0), ())
    found = hashlib.sha256(encode(old)).hexdigest()
    assert found == "f4fcfdb6619f21d5af05f06f1be400807da48c4c264ad91e60ca51fd6e20a729"


def test_predicted_sigmas_of_an_older_log_are_not_taken_for_wall_sums():
    sigmas = (0.02, 0.1, 0.03)
    fields = {"index": 1, "axis": "y", "sums": sigmas, "achieved_sigmas": (0.1, 0.2, 0.3)}
    data = protos.CLASSES["KeyframeDecision"](**fields).SerializeToString()
    read = decode("/keyframe", 7, data)
    assert (read.sums, read.predicted_sigmas) == ((), sigmas)
    assert read.achieved_sigmas == (0.1, 0.2, 0.3)
    assert decode("/keyframe", 7, encode(read)) == read
