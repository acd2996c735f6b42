"""What an operator must know of a Pioneer: its standard report (docs/devices.md, section 2)."""

from __future__ import annotations

from typing import NamedTuple

from slam.drivers.arcos_reports import StandardReport

LOW_VOLTS = 11.5  # V, the manual's warning level for its lead batteries


class Condition(NamedTuple):
    """One fact about the robot."""

    name: str
    value: str  # in words
    warning: str = ""  # what to do about it, or what is wrong; empty if nothing is


def robot_conditions(report: StandardReport) -> tuple[Condition, ...]:
    """Return what the report says of battery, motors, STOP button, stalls and bumpers."""
    volts = f"{report.volts:.1f} V"
    low = f"charge the batteries: {volts}" if report.volts < LOW_VOLTS else ""
    stop, stalled = report.stop_pressed, any(report.stalled)
    touches = any(report.bumpers)
    return (
        Condition("battery", volts, low),
        Condition("motors", "on" if report.motors_enabled else "off"),
        Condition(
            "STOP button", "pressed" if stop else "released",
            "the STOP button is pressed: release it, then press MOTORS" if stop else "",
        ),
        Condition("wheels", *(("stalled", "a wheel is stalled") if stalled else ("free",))),
        Condition(
            "bumpers", *(("pressed", "a bumper touches something") if touches else ("free",))
        ),
    )  # fmt: skip
