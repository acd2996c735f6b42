"""Real recordings with flipped, cut and swapped bytes: an import or one clear line, no more."""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import time
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from slam.logs.errors import LogError
from slam.logs.importers.detect import read_any

from tests.logs import bags
from tests.logs.bags import Maker, drive

REAL = Path(__file__).parents[2].parent / "shared" / "data" / "real"
HANG_S = 30  # of processor time: another program may have the machine meanwhile
MEMORY_BYTES = 1 << 30  # beyond what the process has when it starts
PER_PROCESS = 40

SOURCES = ("bag-v1.2/*.bag", "urg-ccny/*.bag", "tb3-wall/*.bag", "urg-still/*.bag",
           "neato18-test/*.bag", "neato24-square/*.db3", "tb4-mac/*.db3", "rpl-run10/*.mcap",
           "ydx4-1/*.txt")  # fmt: skip


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Flip, cut, swap, repeat or blank pieces; damage to headers is as likely as to the rest."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20))):
        if len(out) < 2:
            break
        at = rng.randrange(min(len(out), rng.choice((200, 5000, len(out)))))
        length = rng.choice((1, 1, 4, 8, 100, 4096))
        kind = rng.randrange(6)
        if kind == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at : at + length] = rng.randbytes(min(length, len(out) - at))
        elif kind == 2 and len(out) > 100:
            del out[at : at + length]
        elif kind == 3:
            other = rng.randrange(len(out))
            a, b = out[at : at + length], out[other : other + length]
            n = min(len(a), len(b))
            out[at : at + n], out[other : other + n] = b[:n], a[:n]
        elif kind == 4:
            out[at : at + length] = bytes(min(length, len(out) - at))
        elif rng.random() < 0.3 and len(out) > 100:
            del out[max(at, 50) :]
        else:
            out[at : at + 8] = (2 ** rng.randrange(64)).to_bytes(8, "little")
    return bytes(out)


def one(path: Path) -> str:
    """Import a file; what came of it, in a word."""
    try:
        log = read_any(path)
        count = sum(1 for _ in log.received())
    except LogError as error:
        text = str(error)
        sound = text.startswith(str(path)) and "\n" not in text and len(text) < 800
        return "refused" if sound else f"unclear: {text[:300]!r}"
    return "whole" if count and not (log.skipped or log.warnings) else "with losses"


def campaign(seeds: range, sources: list[Path], folder: Path) -> dict[str, object]:
    """Import mutations one after the other, in this process; its limits are set for good."""
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    pages = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (pages + MEMORY_BYTES,) * 2)
    results: Counter[str] = Counter()
    bad: list[str] = []
    slowest = 0.0
    for seed in seeds:
        rng = random.Random(seed)
        source = sources[seed % len(sources)]
        path = folder / f"m{seed}{source.suffix}"
        path.write_bytes(mutated(source.read_bytes(), rng))
        began = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, HANG_S)  # ends the process
        try:
            result = one(path)
        except BaseException as error:
            result = f"{type(error).__name__}: {error}"
        signal.setitimer(signal.ITIMER_PROF, 0)
        slowest = max(slowest, time.process_time() - began)
        word = result if result in ("whole", "with losses", "refused") else "fault"
        results[word] += 1
        if word == "fault":
            bad.append(f"seed {seed}, {source.parent.name}: {result[:400]}")
        path.unlink()
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - usage
    return {"results": results, "bad": bad, "slowest_s": slowest, "grown_mb": grown >> 20}


def forked(seeds: range, sources: list[Path], folder: Path) -> dict[str, object]:
    """Run the campaign in a copy of this process, so that its limits end with it."""
    read_end, write_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read_end)
        with os.fdopen(write_end, "w") as out:
            out.write(json.dumps(campaign(seeds, sources, folder)))
        os._exit(0)
    os.close(write_end)
    with os.fdopen(read_end) as answer:
        text = answer.read()
    _, status = os.waitpid(pid, 0)
    if status or not text:
        return {"results": {"fault": 1}, "bad": [f"seeds {seeds}: the process ended, {status}"],
                "slowest_s": HANG_S, "grown_mb": 0}  # fmt: skip
    return json.loads(text)


def run(count: int, folder: Path, first: int = 0) -> dict[str, object]:
    """Import so many mutations; sums over all processes."""
    sources = [next(REAL.glob(pattern)) for pattern in SOURCES]
    for source in sources:
        one(source)  # what is loaded once is loaded before the limits are set
    results: Counter[str] = Counter()
    bad: list[str] = []
    slowest, grown = 0.0, 0
    for start in range(first, first + count, PER_PROCESS):
        seeds = range(start, min(start + PER_PROCESS, first + count))
        part = forked(seeds, sources, folder)
        results.update(part["results"])
        bad += part["bad"]
        slowest, grown = max(slowest, part["slowest_s"]), max(grown, part["grown_mb"])
    return {"results": dict(results), "bad": bad, "slowest_s": slowest, "grown_mb": grown}


def check(count: int, folder: Path) -> None:
    if not REAL.is_dir():
        pytest.skip(f"recordings of real robots are not at {REAL}")
    found = run(count, folder)
    shutil.rmtree(folder, ignore_errors=True)
    assert found["bad"] == []
    assert found["slowest_s"] < HANG_S
    assert found["grown_mb"] < 1024
    assert sum(found["results"].values()) == count


def test_a_few_mutated_recordings_are_imported_or_refused(tmp_path):
    check(18, tmp_path)


def containers(folder: Path) -> list[Path]:
    """A short drive in every container, unpacked, so that damage reaches every word of it."""
    ros1 = drive(10, make=Maker(ros1=True))
    return [
        bags.write_mcap(folder / "a.mcap", drive(10), compression=bags.CompressionType.NONE),
        bags.write_mcap(folder / "b.mcap", drive(10), use_chunking=False),
        bags.write_mcap(folder / "c.mcap", ros1, ros1=True, use_chunking=False),
        bags.write_bag1(folder / "d.bag", ros1),
        next(bags.write_bag2(folder / "e", drive(10), sqlite=True).glob("*.db3")),
    ]


@pytest.mark.parametrize("first", [150, 900])
def test_damage_anywhere_in_a_container_is_one_clear_line(tmp_path, first):
    sources = containers(tmp_path)
    for seed in range(first, first + 50):
        source = sources[seed % len(sources)]
        path = tmp_path / f"m{source.suffix}"
        path.write_bytes(mutated(source.read_bytes(), random.Random(seed)))
        assert one(path) in ("whole", "with losses", "refused"), seed


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_two_thousand_mutated_recordings_are_imported_or_refused(tmp_path):
    check(2000, tmp_path)
