from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.drivers.arcos_protocol import Framer, Id, decode_command
from slam.drivers.arcos_reports import (
    CONFIG,
    STANDARD,
    ConfigReport,
    EncoderReport,
    Identity,
    IoReport,
    StandardReport,
    decode_config,
    decode_encoders,
    decode_identity,
    decode_io,
    decode_standard,
    encode_config,
    encode_encoders,
    encode_identity,
    encode_io,
    encode_standard,
)

FULL = StandardReport(
    x=-5, y=300, theta=-694, left_vel=62, right_vel=-62, battery=130, stall_bumpers=0x0301,
    control=-7, flags=0x23, compass=45, sonar=((0, 296), (15, 5000)), moving=True,
    grip_state=1, analog_port=2, analog=3, digital_in=255, digital_out=254, battery_x10=131,
    charge_state=-1, rot_vel=-200, fault_flags=9, lat_vel=-3, temperature=-127, charge_percent=80,
)  # fmt: skip
CONFIG_REPORT = ConfigReport(
    "Pioneer", "p3dx-sh", "X1", "me", 360, 1000, 100, 0, 2000, 2, 7, 128,
    rot_acc_top=300, trans_vel_max=750, drift_factor=-3, shutdown_volts=110, firmware="2.9",
)  # fmt: skip


def device_packets(dialogue, name):
    framer = Framer()
    packets = [p for side, data in dialogue(name) if side == "<" for p in framer.feed(data, 0)]
    assert framer.skipped_bytes == 0
    return packets


def test_fields_stand_where_the_manual_puts_them():
    payload = encode_standard(FULL)
    wire = bytes(3) + payload  # offsets of docs/devices.md, section 2, count from the header
    assert wire[3] == 0x33
    assert wire[4:6] == (-5).to_bytes(2, "little", signed=True)
    assert wire[8:10] == (-694).to_bytes(2, "little", signed=True)
    assert (wire[14], wire[19], wire[21], wire[22]) == (130, 0x23, 45, 2)
    assert wire[23:26] == bytes([0, 296 & 0xFF, 296 >> 8])
    assert decode_standard(payload) == FULL


def test_flags_have_names():
    assert FULL.motors_enabled
    assert FULL.stalled == (True, True)
    assert FULL.bumpers == (1, 0)
    assert FULL.volts == pytest.approx(13.1)
    assert replace(FULL, battery_x10=None).volts == pytest.approx(13.0)


@pytest.mark.parametrize("cut", range(17))
def test_every_field_of_the_tail_is_optional(cut):
    payload = encode_standard(FULL)
    report = decode_standard(payload[: len(payload) - cut])
    assert report.x == -5
    assert report.sonar == FULL.sonar
    assert report.charge_percent == (80 if cut == 0 else None)
    assert report.grip_state == (1 if cut < 16 else None)


def test_a_tail_longer_than_known_is_skipped():
    assert decode_standard(encode_standard(FULL) + bytes(8)) == FULL


def test_sonar_that_is_counted_but_not_sent_costs_no_pose():
    payload = bytearray(encode_standard(replace(FULL, sonar=(), grip_state=None)))
    payload[19] = 16
    report = decode_standard(bytes(payload))
    assert (report.x, report.sonar, report.grip_state) == (-5, (), None)


@pytest.mark.parametrize("payload", [b"\x32", b"\x32" + bytes(10), b"\x20" + bytes(40)])
def test_what_is_no_standard_report_is_none(payload):
    assert decode_standard(payload) is None


def test_identity_encoders_and_config_come_back():
    identity = Identity("AMRISim", "Pioneer", "p3dx-sh")
    assert decode_identity(encode_identity(identity)) == identity
    assert decode_identity(b"\x02AMR") is None
    counts = EncoderReport(-100_000, 2_000_000)
    assert decode_encoders(encode_encoders(counts)) == counts
    assert decode_encoders(b"\x90abc") is None
    assert decode_config(encode_config(CONFIG_REPORT)) == CONFIG_REPORT
    assert decode_config(encode_config(CONFIG_REPORT)[:60]) is None
    inputs = IoReport((1, 2, 3, 4), (255,), (1023, 0, 7))
    assert decode_io(encode_io(inputs)) == inputs
    assert encode_io(inputs) == bytes.fromhex("f0 04 01020304 01 ff 03 ff03 0000 0700")
    assert all(decode_io(encode_io(inputs)[:cut]) is None for cut in range(1, 15))


def test_the_config_of_a_real_robot_reads_as_its_owner_said():
    """AriaCoda's issue 15: the beginning of what a p3dx-sh sent, filled up with zeros."""
    head = b"\x20Pioneer\0p3dx-sh\0GJC_3156\0\x00"
    tops = bytes.fromhex("6801 e803 2c01 d007 f401")
    report = decode_config(head + tops + b"FAPESP_3156\0\x64" + bytes(64))
    assert (report.serial, report.name) == ("GJC_3156", "FAPESP_3156")
    assert (report.rot_vel_top, report.trans_vel_top, report.sip_cycle) == (360, 1000, 100)


def test_soars_session_decodes(dialogue):
    packets = device_packets(dialogue, "soar__amrisim.hex.gz")
    reports = [decode_standard(p.payload) for p in packets if p.id in STANDARD]
    assert len(packets) == 124
    assert decode_identity(packets[2].payload) == Identity("AMRISim", "Pioneer", "p3dx-sh")
    assert (reports[-1].x, reports[-1].theta, reports[-1].rot_vel) == (568, -694, -200)
    assert reports[0].sonar[7] == (7, 0x0CFA)
    assert all(
        encode_standard(r) == p.payload
        for r, p in zip(reports, [p for p in packets if p.id in STANDARD], strict=True)
    )
    [config] = [decode_config(p.payload) for p in packets if p.id == CONFIG]
    assert (config.sip_cycle, config.watchdog, config.auto_baud) == (100, 2000, 2)
    assert (config.rot_vel_max, config.trans_vel_max, config.pwm_max) == (150, 3000, 400)
    assert (config.rot_acc, config.trans_decel, config.firmware) == (100, 300, "S.0")


def test_players_session_decodes(dialogue):
    packets = device_packets(dialogue, "player_serial__amrisim.hex.gz")
    reports = [decode_standard(p.payload) for p in packets if p.id in STANDARD]
    assert len(packets) == 76
    # With sonar off, one of four reports without readings still counts 16 of them.
    assert sum(not r.sonar for r in reports) == 4
    assert sum(r.grip_state is None for r in reports) == 1
    assert not any(r.moving for r in reports)  # AMRISim never says that it moves


def test_what_foreign_clients_send_is_understood(dialogue):
    framer = Framer()
    wire = b"".join(d for side, d in dialogue("soar__amrisim.hex.gz") if side == ">")
    commands = [decode_command(p.payload) for p in framer.feed(wire, 0)]
    assert framer.skipped_bytes == 0
    assert (Id.VEL, 200) in commands
    assert (Id.RVEL, -20) in commands
    assert commands[-1] == (Id.CLOSE, None)


@settings(deadline=None, max_examples=300)
@given(st.binary(min_size=1, max_size=250), st.sampled_from([0x32, 0x33, 0x20, 0x90, 0xF0, 0x02]))
def test_no_payload_raises(payload, kind):
    payload = bytes([kind]) + payload
    for decode in (decode_standard, decode_config, decode_encoders, decode_identity, decode_io):
        decode(payload)
