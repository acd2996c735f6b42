"""Every setting of a run: one frozen model per stage, one place for each physical quantity."""

from __future__ import annotations

import hashlib
import json
from typing import Self

from pydantic import BaseModel, ConfigDict, model_validator

from slam.backend.pose_graph import GraphConfig
from slam.frontend.keyframes import KeyframeConfig
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import ScanConfig
from slam.mapping.calibration import CalibrationConfig
from slam.mapping.laser import LaserConfig
from slam.mapping.loop_closing import LoopConfig
from slam.mapping.odometry import OdometryConfig, RobotLimits
from slam.mapping.pruning import PruningConfig
from slam.mapping.registration import RegistrationConfig
from slam.mapping.scan_localiser import LocaliseConfig
from slam.maps.occupancy import MapConfig


class SlamConfig(BaseModel):
    """Every setting of a run."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    laser: LaserConfig = LaserConfig()
    robot: RobotLimits = RobotLimits()
    calibration: CalibrationConfig = CalibrationConfig()
    scan: ScanConfig = ScanConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    matcher: MatchConfig = MatchConfig()
    odometry: OdometryConfig = OdometryConfig()
    registration: RegistrationConfig = RegistrationConfig()
    loops: LoopConfig = LoopConfig()
    graph: GraphConfig = GraphConfig()
    pruning: PruningConfig = PruningConfig()
    localise: LocaliseConfig = LocaliseConfig()
    map: MapConfig = MapConfig()

    @model_validator(mode="after")
    def _share_the_laser(self) -> Self:
        """Hand the laser's figures to the stages that need them, where they are no settings."""
        for name, stage in (("scan", self.scan), ("matcher", self.matcher)):
            for key in stage.model_fields_set & LaserConfig.model_fields.keys():
                if getattr(stage, key) != getattr(self.laser, key):
                    raise ValueError(f"set laser.{key}, which {name}.{key} follows")
        noise = {"range_noise": self.laser.range_noise}
        scan = self.scan.model_copy(update={**noise, "max_range": self.laser.max_range})
        object.__setattr__(self, "scan", scan)  # the model is frozen from here on
        object.__setattr__(self, "matcher", self.matcher.model_copy(update=noise))
        return self

    def sha256(self) -> str:
        """Hash of the effective configuration, independent of how it was written down."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()
