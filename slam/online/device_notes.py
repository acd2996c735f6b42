"""What a log says of the devices: who they are, their parameters, and how they stand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from slam.drivers.connection import DeviceEvent
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer_decoder import PioneerDecoder
from slam.drivers.robot_condition import Condition, robot_conditions
from slam.logs.messages import DeviceHealth, LogLine

_LEVELS: Mapping[str, Any] = {"failed": "warning", "lost": "error", "notice": "warning"}


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
    stamp_ns: int,
    device: str,
    link: str,
    decoder: PioneerDecoder | HokuyoDecoder,
    reason: str = "",
) -> DeviceHealth:
    """All counters of a device, its clock, and what else a technician asks first."""
    figures = {name: str(count) for name, count in decoder.counters().items()}
    figures |= clock_model(decoder)
    figures |= {"reason": reason} if reason else {}
    if isinstance(decoder, HokuyoDecoder):
        figures |= {"state": decoder.state.get("STAT", "")}
    elif (report := decoder.latest) is not None:
        figures |= {"battery_v": f"{report.volts:.1f}", "stalled": str(any(report.stalled))}
        figures |= {
            "motors": "on" if report.motors_enabled else "off",
            "stop_button": "pressed" if report.stop_pressed else "released",
            "bumpers": "pressed" if any(report.bumpers) else "free",
        }
    return DeviceHealth(stamp_ns, device, link, tuple(figures), tuple(figures.values()))


class RobotWatch:
    """Notices when the robot's condition changes, and puts that into words."""

    def __init__(self) -> None:
        self.conditions: tuple[Condition, ...] = ()
        self._known: dict[str, str] = {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What needs a hand now."""
        return tuple(condition.warning for condition in self.conditions if condition.warning)

    def look(self, decoder: PioneerDecoder, stamp_ns: int) -> list[LogLine]:
        """Return a line for each thing that is not as it was; the first look tells what is odd."""
        if decoder.latest is None:
            return []
        self.conditions = robot_conditions(decoder.latest)
        return list(self._changes(stamp_ns))

    def forget(self) -> None:
        """The robot is not heard any more: nothing is known of it."""
        self.conditions = ()

    def _changes(self, stamp_ns: int) -> Iterable[LogLine]:
        for name, value, warning in self.conditions:
            # Volts change all the time; what counts is whether they are too few.
            state = str(bool(warning)) if name == "battery" else value
            odd = bool(warning) or (name, value) == ("motors", "off")
            before = self._known.get(name)
            self._known[name] = state
            if state != before and (before is not None or odd):
                level: Any = "warning" if odd else "info"
                yield LogLine(stamp_ns, level, "p3dx", warning or f"{name} {value}")
