"""What can be calibrated, when a value is of use, and how to drive to see it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from slam.evaluation.calibration.model import (
    CURVATURE,
    OFFSET,
    ROTATION,
    TRANSLATION,
    YAW,
    X,
    Y,
)

TURNING = "turn on the spot, several times to the left and to the right, where walls are in view"
_STRAIGHT = "drive straight for some tens of metres, where not only the walls along it are in view"
_CHANGING = "start, stop, and turn to and fro: at a steady pace nothing shows the time"


@dataclass(frozen=True, slots=True)
class Unknown:
    """A thing that can be calibrated: its place in the fit, its unit, when it is of use."""

    name: str  # as in `[calibration]`
    index: int
    unit: str
    per_unit: float  # of the file for one of the fit
    useful: float  # sigma in the unit, beyond which a value is refused
    why: str  # a drive may not show it
    drive: str  # to see it


UNKNOWNS = (
    Unknown("laser_x", X, "m", 1.0, 0.02, "shows in turns alone", TURNING),
    Unknown("laser_y", Y, "m", 1.0, 0.02, "shows in turns alone", TURNING),
    Unknown("laser_yaw_deg", YAW, "deg", math.degrees(1.0), 0.6, "shows on the way", _STRAIGHT),
    Unknown("translation_scale", TRANSLATION, "", 1.0, 0.01, "shows on the way", _STRAIGHT),
    Unknown("rotation_scale", ROTATION, "", 1.0, 0.01, "shows in turns alone", TURNING),
    Unknown("curvature", CURVATURE, "rad/m", 1.0, 0.005, "shows on the way", _STRAIGHT),
    Unknown("time_offset_s", OFFSET, "s", 1.0, 0.02, "shows in changes of pace alone", _CHANGING),
)


@dataclass(frozen=True, slots=True)
class Found:
    """One number, or why there is none."""

    name: str
    unit: str
    value: float
    sigma: float
    stated: float | None  # what counted for true before; None: nothing was said
    refused: str = ""  # why the value is not to be used; empty where it is
    drive: str = ""  # how to see it

    @property
    def off(self) -> float:
        """Sigmas from what was stated; 0 where nothing was."""
        return 0.0 if self.stated is None else abs(self.value - self.stated) / self.sigma
