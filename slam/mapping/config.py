"""Every setting of a run: one frozen model per stage."""

from __future__ import annotations

import hashlib
import json

from pydantic import BaseModel, ConfigDict, Field

from slam.backend.pose_graph import GraphConfig
from slam.frontend.keyframes import KeyframeConfig
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import ScanConfig
from slam.mapping.loop_closing import LoopConfig
from slam.mapping.odometry import OdometryConfig
from slam.mapping.pruning import PruningConfig
from slam.mapping.registration import RegistrationConfig
from slam.mapping.scan_localiser import LocaliseConfig
from slam.maps.occupancy import MapConfig


class SlamConfig(BaseModel):
    """Every setting of a run."""

    model_config = ConfigDict(frozen=True, extra="forbid")

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
    lost_inflation: float = Field(
        10.0, ge=1, description="factor on odometry's sigmas where neither source is trusted"
    )

    def sha256(self) -> str:
        """Hash of the effective configuration, independent of how it was written down."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()
