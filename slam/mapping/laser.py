"""The range finder as the mapping algorithm sees it: its noise and its reach."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class LaserConfig(BaseModel):
    """The range finder, as every stage sees it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    range_noise: float = Field(0.010, gt=0, description="m, one sigma of a single reading")
    max_range: float = Field(60.0, gt=0, description="m, readings beyond are not used")
