"""`slam info` and `slam doctor`: what a log holds and what is odd about it, in words.

All text out of a file goes through `shown`, and lists end somewhere: a log is often somebody
else's.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

from slam.logs.atomic_write import atomic_write
from slam.logs.doctor import Check, Diagnosis, diagnose
from slam.logs.errors import shown
from slam.logs.findings import Finding, Severity, seconds
from slam.logs.importers.detect import is_foreign
from slam.logs.info import ChannelInfo, LogInfo, read_info
from slam.logs.messages import Message
from slam.runs.errors import RunError
from slam.tools.foreign import describe_foreign

_MOST = 50  # lines of a list that are shown
_PROGRESS_EVERY = 200  # messages between two words on progress: it must not cost time
_GAPS = 3  # of a channel, the longest
DOCTOR_CODES: Mapping[Severity | None, int] = {None: 0, "note": 0, "warning": 3, "error": 1}


def describe_log(path: Path) -> str:
    """Channels with rates and gaps, losses, identity and attachments, as text.

    A recording of other programs is described by what an import would find in it.

    Raises:
        LogError: the log cannot be read.
    """
    if is_foreign(path):
        return "\n".join(describe_foreign(path))
    return "\n".join(_lines(read_info(path)))


def _lines(info: LogInfo) -> Iterator[str]:
    yield f"{info.path}: {info.messages} messages in {info.duration_s:.1f} s, {info.bytes} bytes"
    if info.messages:
        yield f"  received from {_utc(info.first_received_ns)} on"
    yield from _some(line for channel in info.channels for line in _channel(channel))
    for name, values in [("run", info.run), *sorted(info.metadata.items())]:
        if values:
            yield f"  {shown(name)}:"
            yield from _some(f"    {shown(k)}: {shown(v)}" for k, v in sorted(values.items()))
    if info.lines:
        yield "  said last:"
    for said in info.lines:
        yield f"    {_utc(said.stamp_ns)} {said.level}: {shown(said.name)} {shown(said.text)}"
    yield from _some(
        f"  attachment: {shown(a.name)}, {a.bytes} bytes of {shown(a.media_type)}"
        for a in info.attachments
    )
    for word, losses in (("recording", info.lost_recording), ("reading", info.lost_reading)):
        yield from _some(
            f"  lost while {word}: {count} {shown(cause)}" for cause, count in losses.items()
        )
    if not info.lost:
        yield "  lost: nothing"


def _channel(channel: ChannelInfo) -> Iterator[str]:
    timing = channel.timing
    rate = "" if math.isnan(timing.rate_hz) else f"{timing.rate_hz:8.2f} Hz"
    schema = shown(channel.schema) or "bytes"
    foreign = "" if channel.known else ", not read by replay"
    yield f"  {shown(channel.topic):<16} {timing.messages:>9} {rate:>11}  {schema}{foreign}"
    longest = sorted(timing.gaps, key=lambda gap: -gap.seconds)[:_GAPS]
    for gap in sorted(longest, key=lambda gap: gap.start_ns):
        yield f"    gap of {seconds(gap.seconds)} from {_utc(gap.start_ns)} on"
    if len(timing.gaps) > _GAPS:
        more = " at least" if timing.more_gaps else ""
        yield f"    and{more} {len(timing.gaps) - _GAPS} shorter gaps"
    if timing.backwards:
        back = seconds(timing.farthest_back_s)
        yield f"    {timing.backwards} stamps run backwards, by {back} at most"
    if timing.duplicates:
        yield f"    {timing.duplicates} stamps repeat the one before"


def _utc(stamp_ns: int) -> str:
    """The time to the millisecond; every stamp that a log can hold has one."""
    when = datetime.fromtimestamp(stamp_ns // 10**9, UTC)
    return f"{when:%Y-%m-%d %H:%M:%S}.{stamp_ns % 10**9 // 10**6:03d} UTC"


def _some(lines: Iterable[str]) -> Iterator[str]:
    """The first lines, and how many there are more."""
    left = 0
    for number, line in enumerate(lines):
        if number < _MOST:
            yield line
        else:
            left += 1
    if left:
        yield f"  ... and {left} more"


def examine_log(
    path: Path,
    json_file: Path | None = None,
    on_progress: Callable[[int], None] = lambda messages: None,
) -> tuple[str, int]:
    """What is odd about a log, as text, and the exit code: 0, 3 on warnings, 1 on errors.

    Args:
        path: the log.
        json_file: where to write the findings for programs; None: nowhere.
        on_progress: given the number of messages read so far, now and then.

    Raises:
        LogError: the log cannot be read.
        RunError: the JSON file cannot be written.
    """
    # The matcher, which `slam info` does without.
    from slam.tools.doctor.calibration_check import CalibrationCheck, known_calibration
    from slam.tools.doctor.motion_check import MotionCheck

    checks: list[Check] = [
        MotionCheck(),
        CalibrationCheck(known_calibration(path)),
        _Counter(on_progress),
    ]
    found = diagnose(path, checks)
    if json_file is not None:
        text = json.dumps(found.as_json(), indent=2, allow_nan=False)
        try:
            atomic_write(json_file, text + "\n")
        except OSError as error:
            raise RunError(f"{json_file}: cannot be written: {error.strerror}") from error
    return "\n".join(_findings(found)), DOCTOR_CODES[found.worst]


class _Counter:
    """A check that finds nothing, and tells how far the reading has come."""

    def __init__(self, on_progress: Callable[[int], None]) -> None:
        self._on_progress, self._messages = on_progress, 0

    def feed(self, message: Message) -> None:
        self._messages += 1
        if self._messages % _PROGRESS_EVERY == 0:
            self._on_progress(self._messages)

    def findings(self) -> Iterator[Finding]:
        return iter(())


def _finding(finding: Finding) -> str:
    """A finding with its topic, and where there is one, the time of its first or worst case."""
    where = f"{shown(finding.topic)}: " if finding.topic else ""
    when = f" ({_utc(finding.at_ns)})" if finding.at_ns else ""
    return f"{finding.severity}: {where}{finding.text}{when}"


def _findings(found: Diagnosis) -> Iterator[str]:
    for topic, drift in sorted(found.drift_ppm.items()):
        if math.isfinite(drift) and drift != 0.0:  # zero: the log knows stamps alone
            yield f"{topic}: the receiving clock gains {drift:.1f} ppm on the device's"
    yield from _some(_finding(finding) for finding in found.findings)
    if not found.findings:
        yield f"{found.path}: nothing odd was found"
