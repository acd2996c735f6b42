"""`slam simulate`: a simulated drive as a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from gtsam import Pose2

from slam.drivers.simulators.drive import BASE_T_LASER, simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.miscalibration import Miscalibration
from slam.drivers.simulators.robot import ODOMETRY_NOISE
from slam.drivers.simulators.worlds import SCENARIOS, scenario
from slam.logs.importers.wishes import parse_mount
from slam.logs.mcap_log import LogWriter
from slam.runs.config_file import nearest
from slam.runs.errors import RunError


@dataclass(frozen=True, eq=False, slots=True)
class Robot:
    """What is true of the simulated robot, and what its log and its odometry take for true."""

    base_T_laser: Pose2 = BASE_T_LASER
    wrong: Miscalibration = field(default_factory=Miscalibration)

    @classmethod
    def of(
        cls, pose: str, stated: str, wheel_scales: str, track_scale: float, delay_s: float
    ) -> Robot:
        """From the words of the command line; `stated` is empty where the log says the truth.

        Raises:
            ValueError: one of them is not what it should be.
        """
        try:
            left, right = (float(part) for part in wheel_scales.split(","))
        except ValueError as error:
            raise ValueError(f"{wheel_scales!r} is not left,right: 1.03,1.03") from error
        wrong = Miscalibration(
            left_scale=left, right_scale=right, track_scale=track_scale, odometry_delay_s=delay_s,
            stated=parse_mount(stated) if stated else None,
        )  # fmt: skip
        return cls(Pose2(*parse_mount(pose)), wrong)


def world_names() -> tuple[str, ...]:
    """Names of the worlds that can be driven through."""
    return tuple(SCENARIOS)


def simulate_log(
    world: str, out: Path, seed: int, laser: str, noise: str, passes: int = 1,
    robot: Robot | None = None,
) -> int:  # fmt: skip
    """Write the drive through a world, and return the number of messages.

    Raises:
        RunError: a name is unknown.
        LogError: the log cannot be written.
    """
    for kind, name, known in (
        ("world", world, tuple(SCENARIOS)),
        ("laser", laser, tuple(LASERS)),
        ("noise", noise, tuple(ODOMETRY_NOISE)),
    ):
        if name not in known:
            raise RunError(f"no {kind} is named {name!r}{nearest(name, known)}")
    robot, count = robot or Robot(), 0
    identity = {"world": world, "seed": str(seed), "laser": laser, "noise": noise}
    identity |= {"passes": str(passes), "odometry_track_m": f"{robot.wrong.track_m:g}"}
    kinds = LASERS[laser], ODOMETRY_NOISE[noise]
    drive = simulate(
        scenario(world, seed), *kinds, seed, passes=passes, base_T_laser=robot.base_T_laser
    )
    with LogWriter(out, identity, keep_partial=False) as log:
        for message in robot.wrong.apply(drive):
            log.write(message)
            count += 1
    return count
