"""What the rangefinder's readings mean in water.

raw = range_scale * n_g * L + range_offset_m: a dive in water shows the product of scale and group index, never the two
apart. Apart they come from the laser's calibration in air (n_g = 1) and from what is known of the water. The dive also
shows where on its beam the laser begins: in air that and the offset are one number, in water the offset does not grow
by n_g as lengths do, so the two together tell (by 0.36 m of offset for each metre of origin).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.beam_fit import BeamFit, fit_beam
from leadline.calibration.group_index import GROUP, with_group_index
from leadline.calibration.laser import LASER, find_stations, laser_prior, reading_sigma, rig_in_medium
from leadline.calibration.spots import Sighting, Station, sightings
from leadline.calibration.virtual_focal import VirtualFocal, virtual_focal
from leadline.errors import InputError
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.samples import Sample

BEND_RAD = 0.02  # at the laser's own window, going from air to water: 5 degrees off the square
BEND_M = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class RangeFit:
    """The fit, the paper's f' from the same stations, and what could not be told apart."""

    fit: BeamFit
    focal: VirtualFocal | None
    before: Rig

    @property
    def gain(self) -> tuple[float, float]:
        """range_scale * n_g and its sigma."""
        laser = self.fit.rig.laser
        assert laser is not None
        slope = np.array([laser.group_index, laser.range_scale])
        cov = self.fit.rig.covariance.of(("laser.range_scale", GROUP))
        return laser.range_scale * laser.group_index, float(np.sqrt(slope @ cov @ slope))

    def learnt(self, name: str) -> float:
        """The share of a parameter's prior sigma that the dive took away: 0 nothing, 1 all."""
        before = float(np.sqrt(range_prior(self.before).of((name,))[0, 0]))
        return max(0.0, 1 - self.fit.sigma(name) / before) if before > 0 else 0.0


def calibrate_range(samples: Iterable[Sample], rig: Rig) -> RangeFit:
    """The rig with its laser's scale, offset, origin, direction and group index as the dive in water shows them.

    Cameras, port and index are held; their uncertainty is not forgotten. InputError says what is missing.
    """
    there = _ready(rig)
    stations, unseen = water_stations(sightings(samples), there)
    start = with_reading_sigma(there, stations)
    fit = fit_beam(start, stations, (*LASER, GROUP), range_prior(start))
    fit = dataclasses.replace(fit, left_out=unseen + fit.left_out)
    focal = virtual_focal(fit.rig, fit.stations)
    if focal is not None:
        fit = dataclasses.replace(fit, rig=dataclasses.replace(fit.rig, virtual_focal_px=(focal.fx_px, focal.fy_px)))
    return RangeFit(fit, focal, start)


def _ready(rig: Rig) -> Rig:
    if rig.laser is None:
        raise InputError("the rig has no laser", "", "run `leadline calibrate laser` on a dive in air first")
    return rig_in_medium(rig, "water")


def water_stations(
    found: Sequence[Sighting], rig: Rig, *, meet_px: float = 1.5
) -> tuple[list[Station], tuple[tuple[str, str], ...]]:
    """The stations of a dive in water, and the frames without one."""
    stations = find_stations(found, rig, "water", meet_px=meet_px)
    names = {station.name for station in stations}
    return stations, tuple((f.name, "no spot of the beam in both images") for f in found if f.name not in names)


def with_reading_sigma(rig: Rig, stations: Sequence[Station]) -> Rig:
    assert rig.laser is not None
    sigma = reading_sigma(stations, rig.laser.range_sigma_m)
    return dataclasses.replace(rig, laser=dataclasses.replace(rig.laser, range_sigma_m=sigma))


def range_prior(rig: Rig, bend_m: float = BEND_M) -> RigCovariance:
    """The rig's covariance with the doubts of going under water: the beam may bend at its window, and the indices are
    known as well as the water is. A laser without a covariance is known by its kind only."""
    cov = rig.covariance
    if not set(LASER) & set(cov.names):
        cov = laser_prior(rig, cov)
    cov = with_group_index(cov)
    matrix = cov.matrix.copy()
    for name in LASER[:6]:
        if name in cov.names:
            place = cov.names.index(name)
            matrix[place, place] += (bend_m if "origin" in name else BEND_RAD) ** 2
    return RigCovariance(cov.names, matrix)
