"""`slam simulate`: a simulated drive as a log."""

from __future__ import annotations

from pathlib import Path

from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.robot import ODOMETRY_NOISE
from slam.drivers.simulators.worlds import SCENARIOS, scenario
from slam.logs.mcap_log import LogWriter
from slam.runs.config_file import nearest
from slam.runs.errors import RunError


def world_names() -> tuple[str, ...]:
    """Names of the worlds that can be driven through."""
    return tuple(SCENARIOS)


def simulate_log(world: str, out: Path, seed: int, laser: str, noise: str, passes: int = 1) -> int:
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
    count = 0
    identity = {"world": world, "seed": str(seed), "laser": laser, "noise": noise}
    identity["passes"] = str(passes)
    kinds = LASERS[laser], ODOMETRY_NOISE[noise]
    with LogWriter(out, identity, keep_partial=False) as log:
        for message in simulate(scenario(world, seed), *kinds, seed, passes=passes):
            log.write(message)
            count += 1
    return count
