"""A laser dive in water refines port, water and laser together: air-calibrated cameras need no boards under water.

What the dive adds to what was known before, in the order of what it is worth:

1. Lengths. The laser's scale is known from air, and the group index goes with the phase index: readings that grow by
   scale * n_g for each metre that the cameras see, through n, weigh the index against itself from two sides.
2. Places. In air the beam was seen without the port. The same beam seen through it says where the port bends rays.
3. Meeting rays. Left and right see the same spot, and the same points of whatever texture is around it; a wrong tilt or
   distance of the port makes their rays miss each other.

All parameters are estimated at once (``beam_fit``), drawn to what the rig's covariance says. The beam may bend at its
own window on the way into the water, and moves sideways with that: the more it has turned, the less its place is
believed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.beam_fit import DIRECTION, BeamFit, fit_beam
from leadline.calibration.group_index import GROUP, GROUP_PER_INDEX, INDEX
from leadline.calibration.matches import misses_px
from leadline.calibration.range import BEND_M, range_prior, water_stations, with_reading_sigma
from leadline.calibration.spots import Station, sightings
from leadline.errors import InputError
from leadline.geometry import LayeredPort
from leadline.ranging.calibration_error import position_cov
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_parameters import get
from leadline.samples import Array, Sample
from leadline.water import Water, WaterState

DISTANCES_M = (0.2, 0.3, 0.5, 0.8, 1.2, 1.6, 2.2)
WINDOW_M = 0.03  # how far behind its own window a laser may begin: sideways by this for each radian that it turned
LEAST_BEND_M = 5e-5
WIDE_INDEX, WIDE_INDEX_SIGMA, STATED_INDEX_SIGMA = 1.338, 0.004, 0.001
ROUGH_MATCH_PX, GOOD_MATCH_PX = 0.5, 0.15
ROUGH_MEET_PX = 6.0  # left with right, through a port that is only guessed


@dataclass(frozen=True, slots=True)
class PortGuess:
    """What is known of a port before anything was seen through it; sigmas are one standard deviation.

    The distance is from the entrance pupil to the glass: measure or read from a drawing what can be.
    """

    distance_m: float = 0.015
    distance_sigma_m: float = 0.010
    tilt_sigma_rad: float = 0.02
    thickness_m: float = 0.002
    thickness_sigma_m: float = 0.001
    index: float = 1.52
    index_sigma: float = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """The rig before (with the port as guessed, where it had none) and after, and the fit between them."""

    before: Rig
    fit: BeamFit

    @property
    def rig(self) -> Rig:
        return self.fit.rig

    def gained(self) -> list[tuple[str, float, float, float]]:
        """(name, value, sigma before, sigma after) of port, water and range, what the dive taught most first."""
        names = [n for n in self.fit.rig.covariance.names if n.startswith(("port.", "water.", "laser.range"))]
        rows = []
        for name in names:
            old = float(np.sqrt(self.before.covariance.of((name,))[0, 0]))
            rows.append((name, _value(self.fit.rig, name), old, self.fit.sigma(name)))
        return sorted(rows, key=lambda row: row[3] / max(row[2], 1e-300))


def refine(
    samples: Iterable[Sample],
    rig: Rig,
    *,
    guess: PortGuess = PortGuess(),
    water: WaterState | None = None,
) -> Refinement:
    """Port, water, laser and cameras together, from a static dive in water with spots and readings.

    rig: with a laser calibrated in air; with a port and its covariance, or without one (then from ``guess`` and
    ``water``, index 1.338 +-0.004 where that is not given). InputError says what is missing.
    """
    if rig.laser is None:
        raise InputError("the rig has no laser", "", "run `leadline calibrate laser` on a dive in air first")
    start = rig if rig.port is not None else with_guessed_port(rig, guess, water)
    stations, unseen = water_stations(sightings(samples, matched=True), start, meet_px=ROUGH_MEET_PX)
    refinement = refine_stations(start, stations)
    left_out = unseen + refinement.fit.left_out
    return Refinement(refinement.before, dataclasses.replace(refinement.fit, left_out=left_out))


def refine_stations(rig: Rig, stations: Sequence[Station]) -> Refinement:
    """``refine`` from the stations of a dive, for a rig with port, water and laser."""
    start = with_reading_sigma(rig, stations)
    fit = _fit(start, _matching(start, stations, ROUGH_MATCH_PX), BEND_M)
    fit = _fit(start, _matching(fit.rig, stations, GOOD_MATCH_PX), _sideways_m(start, fit))
    return Refinement(dataclasses.replace(start, covariance=range_prior(start)), fit)


def _fit(rig: Rig, stations: Sequence[Station], bend_m: float) -> BeamFit:
    prior = range_prior(rig, bend_m)
    return fit_beam(rig, stations, prior.names, prior)


def _matching(rig: Rig, stations: Sequence[Station], slack_px: float) -> list[Station]:
    """The stations with those matches whose rays miss each other like the others of their frame."""
    out = []
    for station in stations:
        off = misses_px(rig, station.matches_px)
        off = np.abs(off - np.nanmedian(off)) if len(off) else off
        out.append(dataclasses.replace(station, matches_px=station.matches_px[off <= slack_px]))
    return out


def _sideways_m(before: Rig, fit: BeamFit) -> float:
    """How far the beam may have moved sideways, from how far it turned or may have turned."""
    assert before.laser is not None
    assert fit.rig.laser is not None
    turned = float(np.sum((fit.rig.laser.direction - before.laser.direction) ** 2))
    doubt = float(np.trace(fit.rig.covariance.of(DIRECTION)))
    return float(np.clip(WINDOW_M * np.sqrt(turned + doubt) + LEAST_BEND_M, LEAST_BEND_M, BEND_M))


def with_guessed_port(rig: Rig, guess: PortGuess, water: WaterState | None) -> Rig:
    """An air rig put behind a port and into water that are known roughly, with the covariance that says how roughly."""
    like = Water.from_state(WaterState(20.0) if water is None else water, rig.laser_wavelength_nm)
    index, index_sigma = (WIDE_INDEX, WIDE_INDEX_SIGMA) if water is None else (like.index, STATED_INDEX_SIGMA)
    shift = index - like.index
    there = Water(
        like.blue + shift, like.green + shift, like.red + shift, like.group_index + GROUP_PER_INDEX * shift, water
    )
    port = LayeredPort((0, 0, 1), guess.distance_m, ((guess.thickness_m, guess.index),), there.index)
    sigmas = {
        "port.normal[0]": guess.tilt_sigma_rad,
        "port.normal[1]": guess.tilt_sigma_rad,
        "port.distance_m": guess.distance_sigma_m,
        "port.layers[0].thickness_m": guess.thickness_sigma_m,
        "port.layers[0].index": guess.index_sigma,
        INDEX: index_sigma,
    }
    names = tuple(n for n in rig.covariance.names if n not in sigmas and n != GROUP)
    matrix = np.zeros((len(names) + len(sigmas),) * 2)
    matrix[: len(names), : len(names)] = rig.covariance.of(names)
    matrix[len(names) :, len(names) :] = np.diag(np.square(list(sigmas.values())))
    laser = None if rig.laser is None else dataclasses.replace(rig.laser, group_index=there.group_index)
    covariance = RigCovariance((*names, *sigmas), matrix)
    return dataclasses.replace(rig, port=port, water=there, laser=laser, covariance=covariance)


def depth_sigmas(rig: Rig, distances_m: Sequence[float] = DISTANCES_M) -> Array:
    """Standard deviation of a stereo point's depth from the calibration alone (N, 2): on the axis, half way out."""
    half_way = 0.25 * rig.left.width / rig.left.fx / WIDE_INDEX
    places = [[(slope * z, 0.0, z) for slope in (0.0, half_way)] for z in distances_m]
    return np.array([[np.sqrt(position_cov(rig, p)[2, 2]) for p in row] for row in places])


def _value(rig: Rig, name: str) -> float:
    return float(get(rig, [name])[0])
