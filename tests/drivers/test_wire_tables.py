"""The tables of docs/devices.md, entry by entry, against bytes that were put together by hand."""

import numpy as np
import pytest
from slam.drivers.arcos_protocol import BAUD_CODES, Id, checksum, encode_command
from slam.drivers.arcos_reports import decode_config, decode_encoders, decode_io, decode_standard
from slam.drivers.scip_protocol import (
    Command,
    ReplyFramer,
    data_lines,
    decode_command,
    decode_information,
    encode_number,
)
from slam.drivers.scip_scan import (
    SensorParameters,
    decode_request,
    decode_scan,
    encode_scan,
    parameters_from,
    ranges_m,
)
from slam.drivers.scip_status import status_name

# Section 2: offset from the packet's start, width, field, what decoding makes of all bits set.
STANDARD = [
    (4, 2, "x", -1), (6, 2, "y", -1), (8, 2, "theta", -1), (10, 2, "left_vel", -1),
    (12, 2, "right_vel", -1), (14, 1, "battery", 255), (15, 2, "stall_bumpers", 65535),
    (17, 2, "control", -1), (19, 2, "flags", 65535), (21, 1, "compass", 255),
]  # fmt: skip
# Likewise behind the sonar readings, from GRIP_STATE on.
TAIL = [
    (0, 1, "grip_state", 255), (1, 1, "analog_port", 255), (2, 1, "analog", 255),
    (3, 1, "digital_in", 255), (4, 1, "digital_out", 255), (5, 2, "battery_x10", 65535),
    (7, 1, "charge_state", -1), (8, 2, "rot_vel", -1), (10, 2, "fault_flags", 65535),
    (12, 2, "lat_vel", -1), (14, 1, "temperature", -1), (15, 1, "charge_percent", 255),
]  # fmt: skip


def standard(marks, sonars=2):
    """A packet from its header on, all zeros but for ones at (offset, width)."""
    packet = bytearray(b"\xfa\xfb\x00\x32" + bytes(18) + bytes([sonars]) + bytes(3 * sonars + 16))
    for offset, width in marks:
        packet[offset : offset + width] = b"\xff" * width
    return bytes(packet)


@pytest.mark.parametrize(("offset", "width", "field", "ones"), STANDARD)
def test_a_field_of_the_standard_report_has_its_place(offset, width, field, ones):
    report, zero = (decode_standard(standard(m)[3:]) for m in ([(offset, width)], []))
    assert getattr(report, field) == ones
    others = [f for _, _, f, _ in STANDARD + TAIL if f != field]
    assert [getattr(report, f) for f in others] == [getattr(zero, f) for f in others]


@pytest.mark.parametrize("sonars", [0, 1, 16])
@pytest.mark.parametrize(("offset", "width", "field", "ones"), TAIL)
def test_a_field_behind_the_sonars_moves_with_their_number(offset, width, field, ones, sonars):
    begin = 23 + 3 * sonars + offset
    report = decode_standard(standard([(begin, width)], sonars)[3:])
    assert getattr(report, field) == ones
    cut = decode_standard(standard([(begin, width)], sonars)[3 : begin + width - 1])
    assert getattr(cut, field) is None


@pytest.mark.parametrize(
    ("number", "name"),
    [(4, "ENABLE"), (5, "SETA"), (7, "SETO"), (11, "VEL"), (18, "CONFIG"), (19, "ENCODER"),
     (21, "RVEL"), (28, "SONAR"), (29, "STOP"), (32, "VEL2"), (50, "HOSTBAUD"), (55, "E_STOP"),
     (253, "RESET")],
)  # fmt: skip
def test_commands_have_the_manuals_numbers(number, name):
    packet = encode_command(Id[name], 1)
    assert packet[:7] == bytes([0xFA, 0xFB, 6, number, 0x3B, 1, 0])
    assert packet[-2:] == checksum(packet[3:-2]).to_bytes(2, "big")


def test_baud_rates_have_the_manuals_codes():
    assert BAUD_CODES == {9600: 0, 19200: 1, 38400: 2, 57600: 3, 115200: 4}


def test_encoder_counts_are_signed_and_low_word_first():
    counts = decode_encoders(b"\x90" + b"\x01\x00\x02\x00" + b"\xff\xff\xff\xff")
    assert (counts.left, counts.right) == (0x20001, -1)


def test_the_config_of_section_2_2_is_read_field_by_field():
    strings = b"Pioneer\0p3dx-sh\0GJC_3156\0"
    tops = bytes([0]) + b"".join(n.to_bytes(2, "little") for n in (360, 1000, 300, 2000, 500))
    u16 = [0x2000 + k for k in range(23)]  # one number a field, to tell them apart
    parts = [b"\x64", b"\x02", b"\x00"]  # sipCycle, hostBaud, aux1Baud
    parts += [n.to_bytes(2, "little") for n in u16[:2]] + [b"\x01"]  # gripper, sonars front, rear
    parts += [n.to_bytes(2, "little") for n in u16[2:5]] + [b"\x00"]  # lowBattery to p2mpacs
    parts += [n.to_bytes(2, "little") for n in u16[5:21]]  # stallVal to transKi
    parts += [bytes([5, 5, 1, 2, 2, 0])]  # front and rear bumps, charger, cycle, autoBaud, gyro
    parts += [b"\xff\xff", b"\x00\x00", (128).to_bytes(2, "little"), b"\x00\x00"]
    config = decode_config(b"\x20" + strings + tops + b"FAPESP_3156\0" + b"".join(parts) + b"3.0\0")
    assert (config.serial, config.name) == ("GJC_3156", "FAPESP_3156")
    assert (config.rot_vel_top, config.trans_vel_top) == (360, 1000)
    assert (config.sip_cycle, config.host_baud, config.auto_baud) == (100, 2, 2)
    assert (config.rev_count, config.watchdog, config.ticks_mm) == (0x2003, 0x2004, 128)
    assert (config.rot_acc_top, config.trans_acc_top, config.pwm_max) == (300, 2000, 500)
    in_order = (
        *("gripper", "front_sonar", "low_battery", "rev_count", "watchdog", "stall_val"),
        *("stall_count", "joy_vel", "joy_rot_vel", "rot_vel_max", "trans_vel_max", "rot_acc"),
        *("rot_decel", "rot_kp", "rot_kv", "rot_ki", "trans_acc", "trans_decel"),
        *("trans_kp", "trans_kv", "trans_ki"),
    )
    assert [getattr(config, name) for name in in_order] == u16[:21]
    assert (config.rear_sonar, config.charger, config.sonar_cycle, config.gyro) == (1, 1, 2, 0)
    assert (config.drift_factor, config.firmware) == (-1, "3.0")


def test_the_iopac_of_section_2_2_has_its_groups_counted():
    inputs = decode_io(bytes.fromhex("f0 04 11 22 33 44 01 80 02 ff03 0100"))
    assert inputs.digital_in == (0x11, 0x22, 0x33, 0x44)
    assert inputs.digital_out == (0x80,)
    assert inputs.analog == (1023, 1)  # 10 bits
    assert decode_io(bytes.fromhex("f0 00 00 00")) == ((), (), ())


# Section 4.4: DMIN, DMAX, ARES, AMIN, AMAX, AFRT, SCAN; points and field of view in degrees.
SENSORS = [
    ("URG-04LX", (20, 5600, 1024, 44, 725, 384, 600), 682, 239.77),
    ("UTM-30LX", (23, 60000, 1440, 0, 1080, 540, 2400), 1081, 270.25),
    ("UXM-30LX-E", (100, 100000, 1440, 0, 760, 380, 1200), 761, 190.25),
    ("UST-10LX", (20, 30000, 1440, 0, 1080, 540, 2400), 1081, 270.25),
]


@pytest.mark.parametrize(("model", "numbers", "points", "degrees"), SENSORS)
def test_geometry_follows_from_the_parameters(model, numbers, points, degrees):
    keys = ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")
    texts = {key: str(n) for key, n in zip(keys, numbers, strict=True)}
    sensor = parameters_from({"MODL": model, "PROT": "SCIP 2.2", **texts})
    assert sensor == SensorParameters(model, *numbers)
    assert sensor.last_step - sensor.first_step + 1 == points
    assert points * np.degrees(sensor.step_rad) == pytest.approx(degrees, abs=0.01)
    assert sensor.bearing(sensor.front_step) == 0.0


@pytest.mark.parametrize(
    ("line", "characters", "lines"),
    [(b"ME0000108001000", 6486, 102), (b"GD0044072501", 2046, 32), (b"MD0180090004000", 543, 9)],
)
def test_replies_have_the_sizes_of_section_4_2(line, characters, lines):
    request = decode_request(line)
    columns = 2 if request.with_intensity else 1
    assert request.values * request.characters * columns == characters
    assert len(data_lines(b"0" * characters)) == lines


@pytest.mark.parametrize(
    ("line", "symbol", "digits", "note"),
    [(b"TM1", "TM", "1", None), (b"SS115200", "SS", "115200", None), (b"%ST", "%ST", "", None),
     (b"MD0000108001000;a_b+1", "MD", "0000108001000", "a_b+1"), (b"SCIP2.0", "SCIP2.0", "", None)],
)  # fmt: skip
def test_command_lines_come_apart(line, symbol, digits, note):
    assert decode_command(line) == Command(symbol, digits, note)


@pytest.mark.parametrize(
    ("symbol", "status", "words"),
    [("BM", "02", "on already"), ("TM", "03", "already"), ("CR", "04", "cannot"),
     ("MD", "01", "start"), ("MS", "05", "before start"), ("ME", "07", "number of scans"),
     ("GD", "10", "off"), ("QT", "0B", "in work"), ("HS", "03", "cannot"), ("RB", "01", "twice")],
)  # fmt: skip
def test_statuses_are_told_by_their_command(symbol, status, words):
    assert words in status_name(symbol, status)


@pytest.mark.parametrize("model", ["UTM-30LX", "URG-04LX"])
def test_numbers_below_dmin_are_codes_and_beyond_dmax_nothing(model):
    sensor = SensorParameters(model, 23, 5600, 1440, 0, 1080, 540, 2400)
    ranges = ranges_m(np.array([0, 1, 7, 22, 23, 5600, 5601, 65533], np.int32), sensor, np.inf)
    assert np.isnan(ranges[[0, 2, 3]]).all()
    assert np.isinf(ranges[1]) == (model == "UTM-30LX")
    assert ranges[4:6].tolist() == pytest.approx([0.023, 5.6])
    assert np.isinf(ranges[6:]).all()


def test_information_lines_are_read_with_and_without_the_semicolon_in_the_sum():
    text = b"MODL:UTM-30LX"
    sums = [bytes([(sum(part) & 0x3F) + 0x30]) for part in (text, text + b";")]
    for total in sums:
        assert decode_information([text + b";" + total]) == ({"MODL": "UTM-30LX"}, 0)
    assert decode_information([text + b";~"])[1] == 1


def test_a_scan_that_counts_down_belongs_to_its_request():
    lines = encode_scan(5, np.array([100, 200, 300], np.int32), 3)
    echo, status = b"MD0000000201007", b"99b"
    wire = b"\n".join([echo, status, *lines]) + b"\n\n"
    [reply] = ReplyFramer().feed(wire, 9)
    scan = decode_scan(reply)
    assert scan.request.count == 7
    assert scan.timestamp == 5
    assert scan.distances.tolist() == [100, 200, 300]
    assert reply.lines[0][:4] == encode_number(5, 4)
