import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.drivers.arcos_protocol import (
    MAX_COUNT,
    Command,
    Framer,
    Id,
    checksum,
    decode_command,
    encode_command,
    encode_packet,
    vel2_argument,
)

SECOND_NS = 1_000_000_000


# The worked examples of docs/devices.md, section 1, as seen on the wire.
@pytest.mark.parametrize(
    ("number", "argument", "wire"),
    [
        (0, None, "fafb03000000"),
        (1, None, "fafb03010001"),
        (2, None, "fafb03020002"),
        (Id.OPEN, 1, "fafb06013b0100023b"),
        (Id.VEL, 200, "fafb060b3bc800d33b"),
        (Id.RVEL, -20, "fafb06151b1400291b"),
        (Id.SONAR, 0, "fafb061c3b00001c3b"),
        (Id.ENABLE, 1, "fafb06043b0100053b"),
        (Id.STOP, None, "fafb031d001d"),
        (Id.CONFIG, None, "fafb03120012"),
    ],
)
def test_commands_are_those_of_the_wire(number, argument, wire):
    assert encode_command(number, argument).hex() == wire
    assert decode_command(bytes.fromhex(wire)[3:-2]) == Command(number, argument)


def test_negative_numbers_go_as_magnitude():
    assert encode_command(Id.VEL, -100)[:7].hex(" ") == "fa fb 06 0b 1b 64 00"


def test_an_odd_byte_is_xored_into_the_low_byte_not_added():
    assert checksum(b"\x01\x02\xff") == 0x0102 ^ 0xFF
    assert checksum(b"\xff\xff\xff\xff") == (2 * 0xFFFF) & 0xFFFF


def test_players_seto_has_a_type_but_no_integer():
    [packet] = Framer().feed(bytes.fromhex("fafb04073b073b"), 0)
    assert decode_command(packet.payload) == Command(Id.SETO)


def test_strings_carry_their_length():
    wire = encode_command(Id.POLLING, b"\x01\x02")
    [packet] = Framer().feed(wire, 0)
    assert packet.payload == b"\x03\x2b\x02\x01\x02"
    assert decode_command(packet.payload) == Command(Id.POLLING, b"\x01\x02")


def test_an_unknown_kind_of_argument_is_no_command():
    assert decode_command(b"\x0b\x77\x01\x02") is None


def test_wheel_speeds_share_an_integer_right_below():
    assert vel2_argument(left=-1, right=1) == 0xFF01  # as in Player's capture: 01 ff


@pytest.mark.parametrize("argument", [70_000, -70_000, b"x" * 250])
def test_what_does_not_fit_is_refused(argument):
    with pytest.raises(ValueError, match=r"does not fit|too long"):
        encode_command(Id.VEL, argument)
    with pytest.raises(ValueError, match="holds"):
        encode_packet(b"")
    with pytest.raises(ValueError, match="holds"):
        encode_packet(bytes(MAX_COUNT))


@pytest.mark.parametrize("chunk", [1, 2, 5, 1000])
def test_packets_do_not_depend_on_how_the_bytes_arrive(chunk):
    wire = b"\xfa" + encode_packet(b"\x32abc") + b"\x00\xfb" + encode_packet(b"\x33de")
    framer, got = Framer(), []
    for at in range(0, len(wire), chunk):
        got += [p.payload for p in framer.feed(wire[at : at + chunk], at)]
    assert got == [b"\x32abc", b"\x33de"]
    assert (framer.packets, framer.skipped_bytes, framer.pending) == (2, 3, 0)


def test_header_bytes_in_data_do_not_split_a_packet():
    inner = encode_packet(b"\x33inner")
    framer, got = Framer(), []
    for at, byte in enumerate(encode_packet(b"\x32" + inner)):
        got += framer.feed(bytes([byte]), at)
    assert [p.payload for p in got] == [b"\x32" + inner]


def test_behind_a_false_header_the_search_goes_on_at_the_next_byte():
    good = encode_packet(b"\x32abc")
    framer = Framer()
    wire = b"\xfa\xfb\x09" + good + good  # the first good packet lies inside the false one
    assert [p.payload for p in framer.feed(wire, 0)] == [b"\x32abc"] * 2
    assert (framer.bad_checksums, framer.skipped_bytes) == (1, 3)


def test_each_packet_has_the_times_of_its_own_bytes():
    first, second = encode_packet(b"\x32a"), encode_packet(b"\x32b")
    framer = Framer()
    assert framer.feed(first[:3], 10) == []
    got = framer.feed(first[3:] + second[:2], 20) + framer.feed(second[2:], 30)
    assert [(p.begun_ns, p.stamp_ns) for p in got] == [(10, 20), (20, 30)]


def test_a_packet_behind_garbage_keeps_its_time():
    framer = Framer()
    framer.feed(b"\xfa\xfb\x10", 5)
    good = encode_packet(b"\x32abcdefgh")
    assert framer.feed(good, 7) == []  # could still be the inside of the first
    [packet] = framer.feed(bytes(16), 9)
    assert (packet.payload, packet.stamp_ns) == (b"\x32abcdefgh", 7)


def test_a_damaged_count_holds_nothing_back_for_more_than_a_cycle():
    framer, got = Framer(), []
    damaged = bytearray(encode_packet(b"\x32" + bytes(38)))
    damaged[2] = MAX_COUNT
    framer.feed(bytes(damaged), 0)
    for cycle in (1, 2, 3):
        sip = encode_packet(b"\x32" + bytes([cycle]) * 38)
        got += [(cycle, p.payload[1]) for p in framer.feed(sip, cycle * SECOND_NS // 9)]
    assert got == [(1, 1), (2, 2), (3, 3)]


@pytest.mark.parametrize("bit", range(8))
@pytest.mark.parametrize("at", [2, 3, 4, 7, 8])
def test_any_turned_bit_is_noticed(at, bit):
    wire = bytearray(encode_packet(b"\x32abc"))
    wire[at] ^= 1 << bit
    framer = Framer()
    assert framer.feed(bytes(wire), 0) == []
    assert framer.feed(encode_packet(b"\x33ok") * 60, SECOND_NS)[-1].payload == b"\x33ok"


@settings(deadline=None, max_examples=200)
@given(st.lists(st.binary(max_size=600), max_size=8), st.data())
def test_garbage_never_raises_nor_fills_the_buffer(chunks, data):
    framer = Framer()
    for i, chunk in enumerate(chunks):
        for packet in framer.feed(chunk, i):
            decode_command(packet.payload)
        assert framer.pending <= MAX_COUNT + 3
    now = SECOND_NS
    good = encode_packet(data.draw(st.binary(min_size=1, max_size=100)))
    assert framer.feed(good, now)[-1].payload == good[3:-2]


@settings(deadline=None, max_examples=200)
@given(st.lists(st.binary(min_size=1, max_size=80), min_size=1, max_size=6), st.data())
def test_packets_survive_any_cut(payloads, data):
    wire = b"".join(map(encode_packet, payloads))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(wire)), max_size=10)))
    framer, got = Framer(), []
    for i, (begin, end) in enumerate(zip([0, *cuts], [*cuts, len(wire)], strict=True)):
        got += [p.payload for p in framer.feed(wire[begin:end], i)]
    assert got == payloads
    assert framer.skipped_bytes == 0


@pytest.mark.slow
def test_millions_of_random_bytes():
    import random

    rng, framer = random.Random(1), Framer()
    for i in range(1000):
        framer.feed(rng.randbytes(5000).replace(b"\x01", b"\xfa\xfb"), i)
        assert framer.pending <= MAX_COUNT + 3
