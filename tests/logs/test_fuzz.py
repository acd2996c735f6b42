"""The reader on mutated logs, where no checksum keeps the damage from it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.logs.reader_oracle import MESSAGES, WORDS, plain_log, read_every_way

SEEDS = tuple(plain_log(chunked, summary) for chunked in (True, False) for summary in (True, False))
LONGEST = max(map(len, SEEDS))

places = st.integers(8, LONGEST)
lengths = st.integers(1, 400)
mutations = st.one_of(
    st.tuples(st.just("bytes"), places, st.binary(min_size=1, max_size=6)),
    st.tuples(st.just("bytes"), places, st.sampled_from(WORDS)),
    st.tuples(st.just("insert"), places, st.binary(min_size=1, max_size=60)),
    st.tuples(st.just("drop"), places, lengths),
    st.tuples(st.just("repeat"), places, lengths),
    st.tuples(st.just("cut"), places, lengths),
)


def mutated(data: bytes, changes: list[tuple]) -> bytes:
    out = bytearray(data)
    for kind, at, what in changes:
        at = min(at, len(out))
        if kind == "bytes":
            out[at : at + len(what)] = what
        elif kind == "insert":
            out[at:at] = what
        elif kind == "drop":
            del out[at : at + what]
        elif kind == "repeat":
            out[at:at] = out[at : at + what]
        elif kind == "cut":
            del out[at:]
    return bytes(out)


@pytest.mark.parametrize("seed", range(len(SEEDS)))
def test_the_plain_logs_are_sound(tmp_path: Path, seed: int):
    (tmp_path / "a.mcap").write_bytes(SEEDS[seed])
    assert read_every_way(tmp_path / "a.mcap") == len(MESSAGES)


def examine(folder: Path, seed: int, changes: list[tuple]) -> None:
    path = folder / "a.mcap"
    path.write_bytes(mutated(SEEDS[seed], changes))
    read_every_way(path)


CHANGES = given(st.sampled_from(range(len(SEEDS))), st.lists(mutations, min_size=1, max_size=5))
RELAXED = {
    "deadline": None,
    "suppress_health_check": [HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
}


@CHANGES
@settings(max_examples=150, **RELAXED)
@pytest.mark.usefixtures("no_sync")
def test_mutated_logs_are_refused_or_read_with_counts(tmp_path: Path, seed: int, changes):
    examine(tmp_path, seed, changes)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@CHANGES
@settings(max_examples=5000, **RELAXED)
@pytest.mark.usefixtures("no_sync")
def test_a_campaign_of_mutated_logs(tmp_path: Path, seed: int, changes):
    examine(tmp_path, seed, changes)
