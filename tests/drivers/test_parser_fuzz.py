"""Millions of random and mutated bytes through both parsers: they always come back."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

_SPEC = importlib.util.spec_from_file_location("oracle", Path(__file__).parent / "parser_oracle.py")
oracle = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(oracle)

PIECES = {
    oracle.Robot: (oracle.ROBOT_HELLO, oracle.sip(7), b"\xfa\xfb", b"\xfa\xfb\xf9", b"\xfa"),
    oracle.Laser: (oracle.LASER_HELLO, oracle.scan(7), b"\n\n", b"MD0180090004000\n99b\n", b"99b\n",
                   b"00P\n", b"PP\n00P\n", b"TM1\n00P\n"),
}  # fmt: skip


def garbage(rng, pieces):
    """Pieces of the protocol, cut, doubled, turned over and mixed with noise."""
    parts = []
    for _ in range(rng.integers(1, 12)):
        piece = bytearray(pieces[rng.integers(len(pieces))])
        match rng.integers(5):
            case 0:
                piece = bytearray(rng.bytes(rng.integers(1, 400)))
            case 1:
                del piece[rng.integers(len(piece)) :]
            case 2:
                piece[rng.integers(len(piece))] ^= 1 << rng.integers(8)
            case 3:
                del piece[rng.integers(len(piece))]
        parts.append(bytes(piece))
    return b"".join(parts)


def storm(kind, total, seed):
    rng, parser, sent = np.random.default_rng(seed), kind(), 0
    while sent < total:
        data = garbage(rng, PIECES[kind])
        sent += len(data)
        cuts = sorted(rng.integers(0, len(data) + 1, 3).tolist())
        for begin, end in zip([0, *cuts], cuts, strict=False):
            parser.feed(data[begin:end])
        oracle.take(parser, data[cuts[-1] :])
    counters = parser.decoder.counters()
    assert counters["skipped_bytes"] > 0
    return counters


@pytest.mark.parametrize("kind", PIECES)
def test_a_hundred_thousand_bytes(kind):
    storm(kind, 100_000, 1)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("kind", PIECES)
def test_five_million_bytes(kind, seed):
    storm(kind, 2_500_000, seed)
