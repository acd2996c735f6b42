"""What is connected to a port: asks politely, changes nothing, and says what it found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from slam.drivers.connection import Clock, Received, steady_utc
from slam.drivers.errors import DriverError, PortError
from slam.drivers.hokuyo import Hokuyo, HokuyoConfig
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer import Pioneer, PioneerConfig
from slam.drivers.pioneer_decoder import PioneerDecoder
from slam.drivers.ports import Port, open_port
from slam.drivers.robot_condition import robot_conditions
from slam.logs.messages import LaserScan, WheelOdometry

Kind = Literal["laser", "p3dx"]
# What sensors say of themselves (STAT) when all is well, whole (sections 4.1 and 8).
SOUND_STATES = ("sensor works well", "stable 000 no error", "sensor is working normally")


@dataclass(frozen=True, slots=True)
class ProbeReport:
    """What stands at a port, in words that an operator can act on."""

    port: str
    kind: Kind | None  # None if nothing known answered
    title: str  # who it is, or why nothing can be said
    facts: tuple[tuple[str, str], ...] = ()  # name and value, in order of importance
    advice: tuple[str, ...] = ()  # what to do next, empty if all is well

    @property
    def sound(self) -> bool:
        """Whether a device answered and nothing is wrong with it."""
        return self.kind is not None and not self.advice


class _Count:
    """Counts the messages that a session hands over."""

    def __init__(self, kind: type) -> None:
        self.stamps: list[int] = []
        self._kind = kind

    def __call__(self, received: Received) -> None:
        if isinstance(received.message, self._kind):
            self.stamps.append(received.receipt_ns)

    def rate_hz(self, seconds: float) -> float:
        """Return messages a second: between them, or in all the `seconds` if there are few."""
        if len(self.stamps) < 3 or self.stamps[-1] == self.stamps[0]:
            return len(self.stamps) / seconds
        return (len(self.stamps) - 1) / ((self.stamps[-1] - self.stamps[0]) * 1e-9)


def probe(
    name: str,
    seconds: float = 1.5,
    kinds: tuple[Kind, ...] = ("laser", "p3dx"),
    *,
    clock: Clock | None = None,
    opener: Callable[[str, int], Port] = open_port,
) -> ProbeReport:
    """Find out what is connected to port `name`, listening to it for `seconds`.

    The laser is asked first: its questions are harmless to a Pioneer, which skips them.  Not to
    every simulator of one: name what is expected in `kinds`, then nothing else is asked.
    Motors are not touched.  Raises nothing of ours: what goes wrong is in the report.
    """
    clock = clock or steady_utc()
    silent: list[str] = []
    for kind in kinds:
        look = _probe_laser if kind == "laser" else _probe_pioneer
        try:
            return look(name, seconds, clock, opener)
        except PortError as error:
            return ProbeReport(name, None, "the port cannot be opened", advice=(str(error),))
        except DriverError as error:
            silent.append(str(error))
    return ProbeReport(name, None, "nothing known answers here", advice=tuple(silent))


def _probe_laser(
    name: str, seconds: float, clock: Clock, opener: Callable[[str, int], Port]
) -> ProbeReport:
    count = _Count(LaserScan)
    laser = Hokuyo(HokuyoConfig(port=name, attempts=2), count, clock, opener)
    trouble = ""
    try:
        laser.connect()
        count.stamps.clear()
        _listen(laser, seconds, clock)
    except PortError:
        raise
    except DriverError as error:
        if laser.decoder.parameters is None and not laser.decoder.version:
            raise
        trouble = str(error)  # it is a laser, and this is what is wrong with it
    finally:
        laser.close()
    return _laser_report(name, laser.decoder, count.rate_hz(seconds), trouble)


def _probe_pioneer(
    name: str, seconds: float, clock: Clock, opener: Callable[[str, int], Port]
) -> ProbeReport:
    count = _Count(WheelOdometry)
    robot = Pioneer(PioneerConfig(port=name), count, clock, opener)
    try:
        title = robot.connect()
        count.stamps.clear()
        _listen(robot, seconds, clock)
    finally:
        robot.close()
    return _pioneer_report(name, title, robot.decoder, count.rate_hz(seconds))


def _listen(session: Hokuyo | Pioneer, seconds: float, clock: Clock) -> None:
    end = clock() + round(seconds * 1e9)
    while clock() < end:
        session.poll()


def _laser_report(name: str, decoder: HokuyoDecoder, rate_hz: float, trouble: str) -> ProbeReport:
    sensor = decoder.parameters
    facts = [(key, value) for key, value in (*decoder.version.items(), *decoder.state.items())]
    advice = [trouble] if trouble else []
    if sensor is not None:
        first, last = (
            sensor.bearing(step) * 57.29578 for step in (sensor.first_step, sensor.last_step)
        )
        facts += [
            ("field of view", f"{first:.1f} to {last:.1f} deg"),
            ("range", f"{sensor.range_min_mm} to {sensor.range_max_mm} mm"),
            ("rate by its own account", f"{1.0 / sensor.sweep_s:.1f} Hz"),
        ]
        if not trouble and rate_hz < 0.9 / sensor.sweep_s:
            advice.append(
                f"only {rate_hz:.1f} scans a second come in: use a faster line, or ask for fewer "
                "beams (cluster) or scans (skip)"
            )
    facts.append(("rate measured", f"{rate_hz:.1f} Hz"))
    offset = decoder.clock.offset_s
    facts.append(("clock offset", "not measured" if offset is None else f"{offset:.3f} s"))
    status = decoder.state.get("STAT", "")
    if status and not is_sound_state(status):
        advice.append(f"the sensor reports a fault, or something unknown here: {status}")
    damaged = decoder.lost["damaged"]
    if damaged:
        advice.append(f"{damaged} scans arrived damaged: check cable and plugs")
    title = decoder.version.get("PROD") or (sensor.model if sensor else "Hokuyo")
    return ProbeReport(name, "laser", title, tuple(facts), tuple(advice))


def is_sound_state(status: str) -> bool:
    """Whether a sensor's own words (STAT) are among those known to mean that all is well."""
    return " ".join(status.lower().split()).rstrip(". ") in SOUND_STATES


def _pioneer_report(name: str, title: str, decoder: PioneerDecoder, rate_hz: float) -> ProbeReport:
    facts = [("connection", title)]
    advice = []
    if decoder.identity is not None:
        facts += [("name", decoder.identity.name), ("subclass", decoder.identity.subclass)]
    if (config := decoder.config) is not None:
        facts += [
            ("serial number", config.serial),
            ("report cycle", f"{config.sip_cycle} ms"),
            ("watchdog", f"{config.watchdog} ms"),
        ]
    else:
        facts.append(("configuration", "none, or damaged as on every p3dx-sh: defaults are used"))
    facts.append(("rate measured", f"{rate_hz:.1f} Hz"))
    if decoder.latest is not None:
        conditions = robot_conditions(decoder.latest)
        facts += [(condition.name, condition.value) for condition in conditions]
        advice += [condition.warning for condition in conditions if condition.warning]
    cycle_s = 0.1 if decoder.config is None else max(decoder.config.sip_cycle, 1) * 1e-3
    if rate_hz < 0.8 / cycle_s:
        advice.append("fewer reports than the robot's cycle promises: is 9600 baud too slow?")
    # A CONFIGpac whose sum never fits counts as one, and a false header in it as another.
    bad = decoder.counters()["bad_checksums"]
    if bad > 2 or (bad and decoder.config is not None):
        advice.append(f"{bad} packets arrived damaged: check cable and adapter")
    return ProbeReport(name, "p3dx", title, tuple(facts), tuple(advice))
