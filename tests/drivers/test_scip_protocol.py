import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.drivers.scip_protocol import (
    MAX_COMMAND,
    MAX_REPLY,
    Command,
    CommandFramer,
    ReplyFramer,
    checksum,
    data_lines,
    decode_command,
    decode_information,
    decode_number,
    encode_number,
    encode_reply,
    information_line,
    is_sound,
    joined_data,
    with_sum,
)
from slam.drivers.scip_status import status_name

CAPTURES = ["example_utm_30lx", "example_urg_04lx", "example_uxm_30lx_e"]


# The specification's own numbers (docs/devices.md, section 4, encoding).
@pytest.mark.parametrize(
    ("value", "text"), [(1234, b"CB"), (5432, b"1Dh"), (16_000_000, b"m2@0"), (0, b"00")]
)
def test_numbers_are_those_of_the_specification(value, text):
    assert encode_number(value, len(text)) == text
    assert decode_number(text) == value


@pytest.mark.parametrize("text", [b"0/", b"p0", b"\xff0", b"\n0"])
def test_other_characters_are_no_number(text):
    with pytest.raises(ValueError, match="SCIP number"):
        decode_number(text)


def test_a_number_too_large_is_refused():
    with pytest.raises(ValueError, match="fit"):
        encode_number(4096, 2)


@pytest.mark.parametrize(("status", "total"), [("00", "P"), ("99", "b"), ("02", "R"), ("0E", "e")])
def test_sums_are_those_of_the_specification(status, total):
    assert with_sum(status.encode()) == (status + total).encode()
    assert is_sound((status + total).encode())
    assert not is_sound((status + "z").encode())


def test_the_semicolon_of_an_information_line_is_not_in_its_sum():
    assert information_line("MODL", "UTM-30LX-EW") == b"MODL:UTM-30LX-EW;I"  # urg_sim's wire
    text = b"MODL:UTM-30LX-EW;"
    both = [text + b"I", text + bytes([checksum(text)])]
    assert decode_information(both) == ({"MODL": "UTM-30LX-EW"}, 0)
    assert decode_information([b"stray", text + b"!", text + b"I"]) == ({"MODL": "UTM-30LX-EW"}, 2)


def test_a_semicolon_in_data_is_data():
    line = with_sum(b"0;;")
    assert joined_data([line]) == b"0;;"


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_data_is_cut_into_lines_of_64(count):
    text = bytes(0x30 + i % 64 for i in range(count))
    lines = data_lines(text)
    assert [len(line) for line in lines[:-1]] == [65] * (len(lines) - 1)
    assert joined_data(lines) == text
    assert joined_data([*lines[:-1], lines[-1][:-1] + b"~"]) is None


@pytest.mark.parametrize(
    ("line", "command"),
    [
        (b"VV", Command("VV")),
        (b"MD0180090004000", Command("MD", "0180090004000")),
        (b"MD0180090004000;me 1", Command("MD", "0180090004000", "me 1")),
        (b"%ST", Command("%ST")),
        (b"SCIP2.0", Command("SCIP2.0")),
        (b"TM0", Command("TM", "0")),
        (b"", None),
        (b"hello", None),
        (b"VV;" + b"x" * 17, None),
    ],
)
def test_commands_are_understood_both_ways(line, command):
    assert decode_command(line) == command
    if command:
        assert command.encode() == line


def test_statuses_have_names():
    assert status_name("MD", "04") == "end step out of range"
    assert status_name("TM", "04") == "not in clock mode"
    assert "check itself" in status_name("MD", "21")
    assert "fault 50" in status_name("MD", "50")
    assert "laser off" in status_name("GD", "10")
    assert status_name("XX", "7Z") == "unknown status 7Z"


@pytest.mark.parametrize("name", CAPTURES)
def test_every_line_of_real_sensors_has_a_sound_sum(capture, name):
    framer = ReplyFramer()
    replies = framer.feed(capture(f"{name}.logr.raw"), 0)
    assert (framer.skipped_bytes, framer.pending) == (0, 0)
    for reply in replies:
        if reply.symbol in ("VV", "PP", "II"):
            assert decode_information(reply.lines)[1] == 0
        else:
            assert all(is_sound(line) for line in reply.lines)
    assert sum(1 + len(reply.lines) for reply in replies) in range(80, 180)


@pytest.mark.parametrize("name", CAPTURES)
def test_replies_answer_the_commands_that_were_sent(capture, name):
    sent = CommandFramer().feed(capture(f"{name}.logw.raw"))
    echoes = [r.echo for r in ReplyFramer().feed(capture(f"{name}.logr.raw"), 0)]
    if sent[-1].startswith(b"ME"):
        sent.append(sent[-1][:-2] + b"00")  # its one report
    assert echoes == sent


@pytest.mark.parametrize("chunk", [1, 2, 7, 4096])
def test_replies_do_not_depend_on_how_the_bytes_arrive(capture, chunk):
    wire, framer = capture("example_urg_04lx.logr.raw"), ReplyFramer()
    got = [r for at in range(0, len(wire), chunk) for r in framer.feed(wire[at : at + chunk], at)]
    assert [(r.echo, r.status, r.lines) for r in got] == [
        (r.echo, r.status, r.lines) for r in ReplyFramer().feed(wire, 0)
    ]


def test_a_reply_has_the_times_of_its_first_and_last_byte():
    framer, wire = ReplyFramer(), encode_reply(b"QT", "00")
    assert framer.feed(wire[:2], 1) == framer.feed(wire[2:-1], 2) == []
    [reply] = framer.feed(wire[-1:] + b"MD", 3)
    assert (reply.begun_ns, reply.stamp_ns) == (1, 3)


def test_garbage_before_a_reply_is_skipped_and_counted():
    framer = ReplyFramer()
    [reply] = framer.feed(b"\xff\x00half a line\n" + encode_reply(b"QT", "00"), 0)
    assert (reply.echo, reply.status, framer.skipped_bytes) == (b"QT", "00", 14)


def test_a_lost_end_costs_neither_of_two_replies():
    first = encode_reply(b"GD0000000101", "00", [with_sum(b"0000"), with_sum(b"000000")])
    replies = ReplyFramer().feed(first[:-1] + encode_reply(b"QT", "00"), 0)
    assert [(r.symbol, len(r.lines)) for r in replies] == [("GD", 2), ("QT", 0)]


def test_a_wrong_status_sum_is_no_reply():
    framer = ReplyFramer()
    assert framer.feed(b"QT\n00Q\n\n", 0) == []
    assert framer.skipped_bytes > 0


def test_scip_1_1_answers_without_sum():
    [reply] = ReplyFramer().feed(b"QT\nE\n\n", 0)
    assert (reply.echo, reply.status) == (b"QT", "E")


def test_lines_of_clients_end_in_every_way():
    framer = CommandFramer()
    assert framer.feed(b"\nVV\rPP\r\nI") == [b"VV", b"PP"]
    assert framer.feed(b"I\n") == [b"II"]
    framer.feed(b"x" * 1000)
    assert framer.skipped_bytes == 1000 - MAX_COMMAND


def test_without_any_end_of_line_the_buffer_stays_small():
    framer = ReplyFramer()
    for i in range(20):
        framer.feed(b"0" * 5000, i)
        assert framer.pending <= MAX_REPLY
    assert framer.feed(b"\n" + encode_reply(b"QT", "00"), 99)[-1].symbol == "QT"


PIECES = st.one_of(
    st.binary(max_size=60),
    st.sampled_from(
        [b"\n", b"\n\n", b"00P", b"MD0000108001000\n99b\n", b"QT\n", b"99b\n", b"E", b"\r"]
    ),
)


@settings(deadline=None, max_examples=300)
@given(st.lists(PIECES, max_size=30))
def test_garbage_never_raises_and_the_second_reply_behind_it_is_found(pieces):
    framer = ReplyFramer()
    for i, piece in enumerate(pieces):
        for reply in framer.feed(piece, i):
            decode_information(reply.lines)
            assert reply.status_name
        assert framer.pending <= MAX_REPLY
    good = encode_reply(b"QT", "00")
    assert framer.feed(good + good, 99)[-1].echo == b"QT"


@settings(deadline=None, max_examples=200)
@given(st.lists(st.binary(max_size=100), max_size=10))
def test_no_command_line_raises(pieces):
    framer = CommandFramer()
    for piece in pieces:
        for line in framer.feed(piece):
            decode_command(line)
