"""Sensor messages decoded anew from the raw bytes of a log, as the drivers did it live.

Bytes of both directions go through the drivers' own decoders with the times of receipt that
were recorded; equal bytes and times give equal messages.  The settings that decoding depends
on are in the attachment `robot.json`.  What no device sends, the mount and the truth, is
taken as it was logged.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer_decoder import MODELS, PioneerDecoder
from slam.logs.errors import LogError
from slam.logs.messages import Message, RawBytes
from slam.logs.parts import Recording
from slam.runs.status import device_losses

SETTINGS = "robot.json"
_RAW_TOPICS = ("/raw/p3dx/rx", "/raw/p3dx/tx", "/raw/laser/rx", "/raw/laser/tx")
_AS_LOGGED = ("/tf", "/truth")


def messages_from_raw(log: Recording, lost: dict[str, int]) -> Iterator[Message]:
    """Yield the messages that SLAM is for; each comes where the bytes are that complete it.

    Channels have the messages that the drivers logged on them, in the same order.  A scan
    and an odometry message that came at the same moment may change places.

    Args:
        log: a recording with raw channels, from its first part on.
        lost: at the end, what the decoders could not use is entered here, per cause.

    Raises:
        LogError: there are no raw bytes, or their beginning, or the settings cannot be read.
    """
    if log.begins_late:
        raise LogError(
            f"{log.path}: is a later part of a recording, and what the devices said of themselves "
            "is in the first: name that, or replay without `--from raw`"
        )
    robot, laser = decoders(log)
    any_bytes = False
    for message in log.messages((*_RAW_TOPICS, *_AS_LOGGED)):
        if isinstance(message, RawBytes):
            any_bytes = True
            yield from (robot if message.device == "p3dx" else laser).decode(message)
        else:
            yield message
    if not any_bytes:
        raise LogError(f"{log.path}: holds no raw bytes: replay it without `--from raw`")
    lost.update(device_losses("p3dx", robot.counters()))
    lost.update(device_losses("laser", laser.counters()))


def decoders(log: Recording) -> tuple[PioneerDecoder, HokuyoDecoder]:
    """Return decoders set up as they were when the log was recorded.

    Raises:
        LogError: the settings in the log cannot be read.
    """
    for attachment in log.attachments():
        if attachment.name == SETTINGS:
            try:
                return _decoders(json.loads(attachment.data))
            except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
                raise LogError(
                    f"{log.path}: the settings in its {SETTINGS} cannot be read: "
                    "replay it without `--from raw`"
                ) from error
    return PioneerDecoder(), HokuyoDecoder()


def _decoders(settings: Any) -> tuple[PioneerDecoder, HokuyoDecoder]:
    name, reach_m = settings["robot"]["model"], settings["laser"]["reach_m"]
    reach_m = math.inf if reach_m is None else float(reach_m)  # JSON has no infinity
    if not reach_m > 0:
        raise ValueError("a reach is positive")
    return PioneerDecoder(None if name == "auto" else MODELS[name]), HokuyoDecoder(reach_m)
