"""The Hokuyo models that can be simulated: parameters, words and habits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from slam.drivers.scip_scan import SensorParameters


@dataclass(frozen=True, kw_only=True, slots=True)
class HokuyoModel:
    """What a model answers; from captures where there are any (docs/devices.md, section 8)."""

    parameters: SensorParameters
    product: str
    firmware: str
    protocol: str
    line: str  # SBPS
    sound: str  # STAT when nothing is wrong
    reach_mm: int  # mm, what it can see at all
    nothing: int  # code of "nothing came back"
    too_near: int  # code of "too near"
    ethernet: bool = False  # states PROT in PP, knows %ST and RT
    serial_speeds: bool = False  # has a baud rate that SS changes
    starts_old: bool = False  # boots in SCIP 1.1 and has to be told SCIP2.0
    all_points: tuple[int, int] | None = None  # steps it answers for; None: those it measures

    @property
    def points(self) -> tuple[int, int]:
        """The first and the last step that can be asked for."""
        p = self.parameters
        return self.all_points or (p.first_step, p.last_step)


def _utm(model: str) -> SensorParameters:
    return SensorParameters(model, 23, 60000, 1440, 0, 1080, 540, 2400)


def _ust(model: str) -> HokuyoModel:
    return HokuyoModel(
        parameters=SensorParameters(model, 20, 30000, 1440, 0, 1080, 540, 2400),
        product=model,
        firmware="4.0.2-A",
        protocol="SCIP 2.2",
        line="Ethernet 100 [Mbps]",
        sound="sensor is working normally",
        reach_mm=30000,
        nothing=65533,
        too_near=4,
        ethernet=True,
    )


MODELS: Mapping[str, HokuyoModel] = MappingProxyType(
    {
        "urg-04lx": HokuyoModel(
            parameters=SensorParameters(
                "URG-04LX(Hokuyo Automatic Co.,Ltd.)", 20, 5600, 1024, 44, 725, 384, 600
            ),
            product="SOKUIKI Sensor URG-04LX",
            firmware="3.1.04(02/Aug./2007)",
            protocol="SCIP 2.0",
            line="19200[bps]<-Default setting by user",
            sound="Sensor works well.",
            reach_mm=5600,
            nothing=0,
            too_near=19,
            serial_speeds=True,
            starts_old=True,
            all_points=(0, 768),  # SCIP 2.0, page 5; outside 44 to 725 nothing is measured
        ),
        "utm-30lx": HokuyoModel(
            parameters=_utm("UTM-30LX(Hokuyo Automatic Co.,Ltd.)"),
            product="SOKUIKI Sensor TOP-URG UTM-30LX",
            firmware="P.1.05(17/Apr./2009)",
            protocol="SCIP 2.0",
            line="USB Full Speed",
            sound="Sensor works well.",
            reach_mm=30000,  # by its data sheet
            nothing=1,
            too_near=4,
        ),
        "utm-30lx-ew": HokuyoModel(
            parameters=_utm("UTM-30LX-EW"),
            product="UTM-30LX-EW",
            firmware="1.1.0 (2011-09-30)",
            protocol="SCIP 2.2",
            line="Ethernet 100 [Mbps]",
            sound="Stable 000 no error.",
            reach_mm=30000,
            nothing=1,
            too_near=4,
            ethernet=True,
        ),
        "ust-10lx": _ust("UST-10LX"),
        "ust-20lx": _ust("UST-20LX"),
    }
)
