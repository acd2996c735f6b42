"""What a log says of the devices: who they are, their parameters, and how they stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from slam.drivers.connection import DeviceEvent
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer_decoder import PioneerDecoder
from slam.logs.messages import DeviceHealth, LogLine

_LEVELS: Mapping[str, Any] = {"failed": "warning", "lost": "error"}


def line_of(event: DeviceEvent) -> LogLine:
    """The event as a line of the log."""
    level = _LEVELS.get(event.kind, "info")
    text = event.detail.removeprefix(f"{event.kind}: ")
    return LogLine(event.stamp_ns, level, event.device, f"{event.kind}: {text}")


def identity(decoder: PioneerDecoder | HokuyoDecoder) -> dict[str, str]:
    """Who the device says it is, and the parameters that its data are read by."""
    facts: dict[str, Any] = {}
    if isinstance(decoder, HokuyoDecoder):
        facts = dict(decoder.version)
        parameters: Any = decoder.parameters
    else:
        facts = {} if decoder.identity is None else decoder.identity._asdict()
        facts |= {} if decoder.config is None else asdict(decoder.config)
        parameters = decoder.model
    facts |= {} if parameters is None else asdict(parameters)
    return {name: str(value) for name, value in facts.items()}


def clock_model(decoder: PioneerDecoder | HokuyoDecoder) -> dict[str, str]:
    """How device time becomes UTC; a Pioneer has no clock, its reports bear their receipt."""
    if isinstance(decoder, PioneerDecoder):
        return {"clock": "time of receipt"}
    clock = decoder.clock
    model = {"clock": "device", "clock_drift_ppm": f"{1e6 * clock.drift:.0f}"}
    if clock.offset_s is not None:
        model["clock_offset_s"] = f"{clock.offset_s:.6f}"
    return model


def health(
    stamp_ns: int, device: str, link: str, decoder: PioneerDecoder | HokuyoDecoder
) -> DeviceHealth:
    """All counters of a device, its clock, and what else a technician asks first."""
    figures = {name: str(count) for name, count in decoder.counters().items()}
    figures |= clock_model(decoder)
    if isinstance(decoder, HokuyoDecoder):
        figures |= {"state": decoder.state.get("STAT", "")}
    elif (report := decoder.latest) is not None:
        figures |= {"battery_v": f"{report.volts:.1f}", "stalled": str(any(report.stalled))}
    return DeviceHealth(stamp_ns, device, link, tuple(figures), tuple(figures.values()))
