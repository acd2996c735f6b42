"""Which P3-DX is simulated, and what it says of itself; sections are those of docs/devices.md."""

from __future__ import annotations

from dataclasses import dataclass

from slam.drivers.arcos_protocol import BAUD_CODES
from slam.drivers.arcos_reports import ConfigReport
from slam.drivers.pioneer_decoder import MODELS


@dataclass(frozen=True, kw_only=True, slots=True)
class PioneerBuild:
    """Which robot it is, and what is wrong with it."""

    name: str = "simulated_1"
    subclass: str = "p3dx-sh"
    baud: int = 9600  # HostBaud in FLASH
    cycle_s: float = 0.1  # s, SipCycle
    watchdog_s: float = 2.0  # s without a packet until the robot stops (section 1.2)
    auto_baud: bool = True  # takes HOSTBAUD
    motors_enabled: bool = True  # somebody has pressed the MOTORS button
    tells_moving: bool = True  # False: type 0x32 always, as AMRISim does
    tail_bytes: int = 16  # of the standard report behind the sonar; old firmware sends fewer
    bad_config_sum: bool = False  # as a real p3dx-sh sends it (section 2.2)
    answers_config: bool = True
    counts_16_bits: bool = False  # position counter of AMRISim instead of 15 bits
    reboots: tuple[tuple[float, float], ...] = ()  # (s of simulation, s it takes)

    def __post_init__(self) -> None:
        """Refuse robots that do not exist."""
        if self.subclass not in MODELS or self.baud not in BAUD_CODES or self.cycle_s <= 0.0:
            raise ValueError(f"no such robot: {self}")

    def config(self) -> ConfigReport:
        """Return its FLASH; ARIA takes its limits from there, and would not drive by zeros.

        The tops are those of a real p3dx-sh (section 2.2), RevCount, TicksMM and gains
        as in section 3 and the makers' defaults; no capture has the whole of it.
        """
        return ConfigReport(
            robot_class="Pioneer", subclass=self.subclass, serial="SIM_0001", name=self.name,
            rot_vel_top=360, trans_vel_top=1000, rot_acc_top=300, trans_acc_top=2000, pwm_max=500,
            sip_cycle=round(self.cycle_s * 1000.0), host_baud=BAUD_CODES[self.baud],
            watchdog=round(self.watchdog_s * 1000.0), auto_baud=2 if self.auto_baud else 0,
            front_sonar=1, rear_sonar=1, sonar_cycle=40, low_battery=115, shutdown_volts=110,
            stall_val=200, stall_count=100, joy_vel=750, joy_rot_vel=50,
            rot_vel_max=100, trans_vel_max=750, rot_acc=100, rot_decel=100, rot_kp=40, rot_kv=20,
            trans_acc=300, trans_decel=300, trans_kp=40, trans_kv=30,
            rev_count=16570, ticks_mm=128, firmware="2.9",
        )  # fmt: skip
