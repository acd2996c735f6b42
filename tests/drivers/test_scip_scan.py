import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.drivers.hokuyo import HokuyoConfig
from slam.drivers.scip_protocol import ReplyFramer, decode_information, encode_reply, with_sum
from slam.drivers.scip_scan import (
    ScanRequest,
    SensorParameters,
    decode_request,
    decode_scan,
    decode_values,
    encode_scan,
    parameters_from,
    ranges_m,
)

UTM = SensorParameters("UTM-30LX", 23, 60000, 1440, 0, 1080, 540, 2400)
URG = SensorParameters("URG-04LX", 20, 5600, 1024, 44, 725, 384, 600)
PAPER = ScanRequest("MD", 180, 900, 4)


def last_scan(wire):
    return decode_scan(ReplyFramer().feed(wire, 0)[-1])


def reply_with(distances, request=None, intensities=None, echo=None):
    request = request or ScanRequest("MD", 0, len(distances) - 1)
    lines = encode_scan(77, np.asarray(distances, np.int32), request.characters, intensities)
    [reply] = ReplyFramer().feed(encode_reply(echo or request.encode(), "99", lines), 0)
    return reply


# What docs/devices.md, section 8, says of the captures.
@pytest.mark.parametrize(
    ("name", "timestamp", "count", "first", "most"),
    [
        ("example_utm_30lx", 4821609, 1081, [45, 48, 49, 50, 49], 5856),
        ("example_urg_04lx", 6968830, 682, [392, 392, 391, 385, 381], 4166),
        ("example_uxm_30lx_e", 3293169, 761, [353, 353, 588, 1311, 1343], 3179),
    ],
)
def test_scans_of_real_sensors(capture, name, timestamp, count, first, most):
    scan = last_scan(capture(f"{name}.logr.raw"))
    assert (scan.timestamp, len(scan.distances)) == (timestamp, count)
    assert scan.distances[:5].tolist() == first
    assert scan.distances.max() == most
    if name == "example_utm_30lx":
        assert scan.intensities[:4].tolist() == [1809, 1780, 1792, 1746]
    if name == "example_urg_04lx":
        assert set(scan.distances[scan.distances < 20].tolist()) == {0, 7, 10}


def test_parameters_of_a_real_sensor(capture):
    replies = ReplyFramer().feed(capture("example_urg_04lx.logr.raw"), 0)
    [first, _] = [decode_information(r.lines)[0] for r in replies if r.symbol == "PP"]
    sensor = parameters_from(first)
    assert replace(sensor, model="URG-04LX") == URG
    assert math.degrees(sensor.bearing(725) - sensor.bearing(44)) == pytest.approx(239.41, abs=0.01)


def test_parameters_are_found_by_name_and_must_all_be_there():
    values = {"MODL": "X", "PROT": "SCIP 2.2", "DMIN": "23", "DMAX": "60000", "ARES": "1440"}
    values |= {"AMIN": "0", "AMAX": "1080", "AFRT": "540", "SCAN": "2395"}
    assert parameters_from(values) == SensorParameters("X", 23, 60000, 1440, 0, 1080, 540, 2395)
    for wrong in ({"SCAN": "0"}, {"ARES": "x"}, {"AMIN": "2000"}):
        assert parameters_from(values | wrong) is None
    del values["AFRT"]
    assert parameters_from(values) is None


def test_the_papers_181_beams():
    config = HokuyoConfig(port="-", angle_min=-math.pi / 2, angle_max=math.pi / 2, cluster=4)
    assert config.request(UTM) == PAPER
    assert PAPER.encode() == b"MD0180090004000"
    assert PAPER.values == 181
    assert HokuyoConfig(port="-").request(UTM).encode() == b"MD0000108001000"
    assert HokuyoConfig(port="-", intensity=True, skip=2).request(URG).encode()[:2] == b"ME"


@pytest.mark.parametrize(
    "request_",
    [
        PAPER,
        ScanRequest("GD", 0, 1080),
        ScanRequest("MS", 44, 725, 2, 3, 5),
        ScanRequest("GE", 5, 6),
    ],
)
def test_requests_come_back(request_):
    assert decode_request(request_.encode()) == request_
    assert decode_request(request_.encode() + b";note") == request_


@pytest.mark.parametrize("echo", [b"MD018009000400", b"VV", b"MDabcd090004000", b"QT;MD", b""])
def test_other_lines_are_no_request(echo):
    assert decode_request(echo) is None


def test_the_echo_counts_down_in_its_last_two_digits():
    request = ScanRequest("MD", 0, 1080, 1, 0, 10)
    assert request.is_answered_by(b"MD0000108001009")
    assert not request.is_answered_by(b"MD0000108002009")
    assert not request.is_answered_by(b"QT")


def test_values_cross_lines():
    distances = list(range(100, 165))  # 65 * 3 characters do not divide into 64
    assert reply_with(distances).lines[1][:-1] != reply_with(distances).lines[1]
    assert decode_scan(reply_with(distances)).distances.tolist() == distances


def test_two_characters_end_at_4095():
    scan = decode_scan(reply_with([20, 5000], ScanRequest("MS", 0, 1)))
    assert scan.distances.tolist() == [20, 4095]


def test_intensities_stand_between_the_ranges():
    bright = np.array([7, 8], np.int32)
    scan = decode_scan(reply_with([100, 200], ScanRequest("ME", 0, 1), bright))
    assert scan.distances.tolist() == [100, 200]
    assert scan.intensities.tolist() == [7, 8]


def test_a_scan_of_another_length_than_asked_is_refused():
    assert decode_scan(reply_with([100] * 10, echo=b"MD0000001001000")) is None


def test_a_scan_with_any_damaged_line_is_refused():
    reply = reply_with(list(range(1000, 1100)))
    for at, line in enumerate(reply.lines):
        turned = line[:1] + bytes([line[1] ^ 1]) + line[2:]
        assert decode_scan(replace(reply, lines=(*reply.lines[:at], turned))) is None
        assert decode_scan(replace(reply, lines=reply.lines[:at] + reply.lines[at + 1 :])) is None


def test_a_character_that_the_sum_does_not_see_is_refused():
    """The sum is modulo 64: a turned bit 6 leaves it as it was."""
    reply = reply_with([100, 200, 300])
    turned = bytes([reply.lines[1][0] ^ 0x40]) + reply.lines[1][1:-1]
    assert with_sum(turned)[-1] == reply.lines[1][-1]
    assert decode_scan(replace(reply, lines=(reply.lines[0], with_sum(turned)))) is None


def test_codes_become_inf_and_nan():
    utm = ranges_m(np.array([0, 1, 2, 4, 22, 23, 1000, 60000, 60001, 65533]), UTM, math.inf)
    np.testing.assert_array_equal(utm[[1, 8, 9]], np.inf)
    assert np.isnan(utm[[0, 2, 3, 4]]).all()
    np.testing.assert_allclose(utm[[5, 6, 7]], [0.023, 1.0, 60.0], rtol=1e-6)
    assert utm.dtype == np.float32
    urg = ranges_m(np.array([0, 1, 7, 19, 20, 5601]), URG, math.inf)
    assert np.isnan(urg[:4]).all()  # says nothing about free space
    assert np.isinf(urg[5])


def test_what_is_beyond_the_wanted_reach_is_inf():
    np.testing.assert_array_equal(
        ranges_m(np.array([1000, 31000]), UTM, 30.0), np.array([1.0, np.inf], np.float32)
    )


def test_bearings_are_anticlockwise_from_the_front():
    assert UTM.bearing(540) == 0.0
    assert UTM.bearing(900) == pytest.approx(math.pi / 2)
    assert UTM.nearest_step(10.0) == 1080
    assert UTM.step_s * 1e6 == pytest.approx(17.4, abs=0.05)


@settings(deadline=None, max_examples=200)
@given(st.lists(st.integers(0, 2**18 - 1), min_size=1, max_size=200))
def test_every_range_survives_the_wire(distances):
    assert decode_scan(reply_with(distances)).distances.tolist() == distances


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_damage_is_refused_or_harmless(data):
    """One turned bit anywhere: no scan, or the very same."""
    distances = [1000, 1100, 1200, 30]
    request = ScanRequest("MD", 0, 3)
    lines = encode_scan(77, np.array(distances, np.int32), 3)
    wire = bytearray(encode_reply(request.encode(), "99", lines))
    wire[data.draw(st.integers(0, len(wire) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    for reply in ReplyFramer().feed(bytes(wire) + b"\n\n", 0):
        scan = decode_scan(reply)
        if scan is not None and scan.request.encode()[:12] == request.encode()[:12]:
            assert scan.distances.tolist() == distances


@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=60), st.sampled_from([2, 3]))
def test_no_data_raises(text, characters):
    decode_values(text[: len(text) // characters * characters], characters)
