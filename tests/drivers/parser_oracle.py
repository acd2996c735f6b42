"""What the parsers of both devices must hold to, whatever bytes come in."""

import numpy as np
from slam.drivers.arcos_protocol import MAX_COUNT, Framer, encode_packet
from slam.drivers.arcos_reports import Identity, StandardReport, encode_identity, encode_standard
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer_decoder import PioneerDecoder
from slam.drivers.scip_protocol import (
    MAX_REPLY,
    ReplyFramer,
    encode_reply,
    information_line,
    with_sum,
)
from slam.drivers.scip_scan import encode_scan
from slam.logs.messages import LaserScan, RawBytes, WheelOdometry

PARAMETERS = {"MODL": "UTM-30LX", "DMIN": 23, "DMAX": 60000, "ARES": 1440, "AMIN": 0,
              "AMAX": 1080, "AFRT": 540, "SCAN": 2400}  # fmt: skip
CYCLE_NS = 110_000_000  # longer than ARIA's patience with half a packet


def sip(x=0):
    return encode_packet(encode_standard(StandardReport(x=x % 0x7FFF, sonar=((3, 900),))))


def scan(count=0):
    ranges = np.arange(181, dtype=np.int32) * 25 + 30
    return encode_reply(b"MD0180090004000", "99", encode_scan(count, ranges, 3))


ROBOT_HELLO = encode_packet(encode_identity(Identity("a", "Pioneer", "p3dx-sh")))
LASER_HELLO = encode_reply(
    b"PP", "00", [information_line(key, str(value)) for key, value in PARAMETERS.items()]
)


class Robot:
    """A decoder that knows its robot, and what it holds back."""

    device, most, message = "p3dx", MAX_COUNT + 3, WheelOdometry

    def __init__(self):
        self.decoder, self.framer, self.now = PioneerDecoder(), Framer(), 0
        self.feed(ROBOT_HELLO)

    def feed(self, data):
        self.now += CYCLE_NS
        self.packets = self.framer.feed(data, self.now)
        assert self.framer.pending <= self.most
        return list(self.decoder.decode(RawBytes(self.now, self.device, "rx", data)))

    def has_framed(self, good):
        return any(encode_packet(packet.payload) == good for packet in self.packets)

    def good(self):
        return sip(self.now // CYCLE_NS)


class Laser(Robot):
    """Likewise for a laser."""

    device, most, message = "laser", MAX_REPLY, LaserScan

    def __init__(self):
        self.decoder, self.framer, self.now = HokuyoDecoder(), ReplyFramer(), 0
        self.feed(LASER_HELLO)

    def good(self):
        return scan(self.now // 1_000_000)

    def has_framed(self, good):
        return any(
            b"\n".join([r.echo, with_sum(r.status.encode()), *r.lines]) + b"\n\n" == good
            for r in self.packets
        )


def take(parser, garbage):
    """Feed garbage; of what comes behind it one packet may be lost, and no more."""
    parser.feed(garbage)
    messages = parser.feed(parser.good())
    second = parser.good()
    messages += parser.feed(second)
    assert parser.has_framed(second)
    for _ in range(4):  # a clock that garbage has set wrong is given up after some readings
        messages += parser.feed(parser.good())
    assert any(isinstance(message, parser.message) for message in messages)
