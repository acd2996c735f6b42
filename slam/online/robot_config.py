"""`robot.toml`: the ports of a robot, where its laser sits, how to record and how to map."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from slam.drivers.hokuyo import HokuyoConfig
from slam.drivers.pioneer import PioneerConfig
from slam.drivers.pioneer_decoder import MODELS
from slam.logs.messages import LaserExtrinsics
from slam.logs.recording import RecorderConfig
from slam.mapping.calibration import CalibrationConfig
from slam.mapping.config import SlamConfig
from slam.runs.config_file import load_config, load_model
from slam.runs.errors import ConfigError


class RobotPort(BaseModel):
    """The Pioneer; there is no setting that would let it move."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    port: str = Field(min_length=1, description="serial device, or tcp://host:port")
    baud: int = Field(9600, description="speed at which the robot boots")
    fast_baud: int = Field(38400, description="speed to change to where the robot can; 0: never")
    model: Literal["auto", "p3dx-sh", "p3dx"] = Field(
        "auto", description="whose conversion factors to use; auto: what the robot says it is"
    )
    silence_s: float = Field(1.0, gt=0, description="s without a report: the robot is gone")

    @model_validator(mode="after")
    def _possible(self) -> RobotPort:
        self.driver()
        return self

    def driver(self) -> PioneerConfig:
        """The driver's configuration, without consent to motion."""
        return PioneerConfig(
            port=self.port,
            baud=self.baud,
            fast_baud=self.fast_baud or None,
            model=None if self.model == "auto" else MODELS[self.model],
            silence_s=self.silence_s,
        )


class LaserPort(BaseModel):
    """The Hokuyo and what is asked of it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    port: str = Field(min_length=1, description="serial device, or tcp://192.168.0.10:10940")
    baud: int = Field(19200, gt=0, description="speed of RS232 models; USB and Ethernet have none")
    from_deg: float = Field(-180.0, ge=-180, description="deg, first bearing; its own limit binds")
    to_deg: float = Field(180.0, le=180, description="deg, last bearing; its own limit binds")
    cluster: int = Field(1, ge=1, le=99, description="steps joined into one beam")
    skip: int = Field(0, ge=0, le=9, description="scans left out between two")
    reach_m: float = Field(math.inf, gt=0, description="m, farther readings count as no return")
    silence_s: float = Field(1.0, gt=0, description="s without a scan: the laser is gone")

    @model_validator(mode="after")
    def _possible(self) -> LaserPort:
        if self.from_deg >= self.to_deg:
            raise ValueError("from_deg must be less than to_deg")
        return self

    def driver(self) -> HokuyoConfig:
        """The driver's configuration."""
        return HokuyoConfig(
            port=self.port,
            baud=self.baud,
            angle_min=math.radians(self.from_deg),
            angle_max=math.radians(self.to_deg),
            cluster=self.cluster,
            skip=self.skip,
            reach_m=self.reach_m,
            silence_s=self.silence_s,
        )


class MountConfig(BaseModel):
    """Where the laser sits: `base_T_laser`, seen from the middle of the wheel axis."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    x: float = Field(allow_inf_nan=False, description="m ahead of the wheel axis")
    y: float = Field(0.0, allow_inf_nan=False, description="m to the left")
    theta_deg: float = Field(
        0.0, allow_inf_nan=False, description="deg, heading of its middle beam, anticlockwise"
    )

    def message(self, stamp_ns: int) -> LaserExtrinsics:
        """The mount as the log has it."""
        return LaserExtrinsics(stamp_ns, self.x, self.y, math.radians(self.theta_deg))


class RecordingConfig(BaseModel):
    """The log of all bytes and messages."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    queue_messages: int = Field(
        8192, ge=64, description="messages that may wait for the disk; more are lost, and counted"
    )
    reserve_mib: int = Field(
        256, ge=0, description="MiB to leave free on the disk; with less recording ends"
    )
    rotate_mib: int = Field(0, ge=0, description="MiB after which a new file begins; 0: never")
    rotate_minutes: float = Field(
        0.0, ge=0, allow_inf_nan=False, description="minutes after which a new file begins"
    )

    @property
    def rotates(self) -> bool:
        """Whether there may be several files, which stay as they are recorded."""
        return self.rotate_mib > 0 or self.rotate_minutes > 0

    def recorder(self, recompress: bool) -> RecorderConfig:
        """The recorder's configuration."""
        return RecorderConfig(
            queue_messages=self.queue_messages,
            reserve_bytes=self.reserve_mib * 2**20,
            rotate_bytes=self.rotate_mib * 2**20,
            rotate_s=self.rotate_minutes * 60.0,
            recompress=recompress,
        )


class RobotConfig(BaseModel):
    """All of `robot.toml`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    robot: RobotPort | None = None  # without one the map is made by the laser alone
    laser: LaserPort
    mount: MountConfig = MountConfig(x=0.0, y=0.0)
    recording: RecordingConfig = RecordingConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    slam: SlamConfig = SlamConfig()

    @model_validator(mode="after")
    def _complete(self) -> RobotConfig:
        """Without a robot there is no odometry to wait for; with one, the laser sits somewhere."""
        if self.robot is not None and "mount" not in self.model_fields_set:
            raise ValueError("[mount] is missing: say where the laser sits on the robot")
        if self.robot is None:
            odometry = self.slam.odometry.model_copy(update={"use": False})
            slam = self.slam.model_copy(update={"odometry": odometry})
            object.__setattr__(self, "slam", slam)  # the model is frozen from here on
        return self

    @model_validator(mode="after")
    def _calibrated(self) -> RobotConfig:
        """Hand the calibration to the pipeline, which corrects what it is given."""
        if "calibration" in self.model_fields_set:
            slam = self.slam.model_copy(update={"calibration": self.calibration})
            object.__setattr__(self, "slam", slam)  # the model is frozen from here on
        return self


class CalibrationFile(BaseModel):
    """What `slam calibrate` writes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    calibration: CalibrationConfig


def _port_itself(port: str) -> str:
    """What a name stands for: links of /dev/serial/by-id point to the device."""
    return port if "://" in port else os.path.realpath(port)


def load_robot(path: Path, overrides: Sequence[str] = ()) -> RobotConfig:
    """Read `robot.toml`, then apply overrides.

    An override names a setting as the file does (`laser.skip=3`), or one of the pipeline as
    `slam replay` does (`keyframes.method=constant` for `slam.keyframes.method`).

    Raises:
        ConfigError: the file cannot be read, or a key or value is not acceptable.
    """
    config = load_model(RobotConfig, path, [_full_name(override) for override in overrides])
    robot = config.robot
    if robot is not None and _port_itself(robot.port) == _port_itself(config.laser.port):
        raise ConfigError(
            f"{path}: robot.port and laser.port are the same port, {config.laser.port}: "
            "`slam drivers probe PORT` says which device is where"
        )
    return config


def load_slam(
    path: Path | None, overrides: Sequence[str] = (), calibration: Path | None = None
) -> SlamConfig:
    """Settings of the pipeline from a file of them, or from the `[slam]` part of a `robot.toml`.

    A file of `slam calibrate` takes the place of the calibration in that; overrides come last.

    Raises:
        ConfigError: like `load_robot`.
    """
    if path is not None and _is_of_a_robot(path):
        config = load_robot(path, overrides).slam
    else:
        config = load_config(path, overrides)
    if calibration is None:
        return config
    own = [one for one in overrides if one.strip().startswith("calibration.")]
    found = load_model(CalibrationFile, calibration, own).calibration
    return config.model_copy(update={"calibration": found})


def _is_of_a_robot(path: Path) -> bool:
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # who loads it says what is wrong
        return False
    devices = (found.get("robot"), found.get("laser"))  # settings of a run have these sections too
    ports = [one for one in devices if isinstance(one, dict) and "port" in one]
    return bool(ports or "slam" in found)


def _full_name(override: str) -> str:
    section = override.partition("=")[0].partition(".")[0].strip()
    own = section in RobotConfig.model_fields  # of a device, even where the pipeline has one too
    short = section in SlamConfig.model_fields and not own
    return f"slam.{override.strip()}" if short else override
