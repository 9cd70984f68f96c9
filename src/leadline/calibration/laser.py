"""Where the laser's beam runs and what its readings mean, from a static dive with its spot in both images.

Moving the origin along the beam and changing the offset cannot be told apart by readings in one medium: they are one
number. The origin stands where the rig had it, or abreast of the left pupil, +-5 cm along the beam, and the offset is
what goes with that; the covariance ties both together, so that in the medium of the calibration the doubt cancels, and
in water, where the offset does not scale with the group index but the length does, what is left of it shows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import least_squares

from leadline.calibration.beam_fit import DIRECTION, ORIGIN, BeamFit, fit_beam
from leadline.calibration.group_index import with_group_index
from leadline.calibration.spots import Sighting, Station, sightings, spot_stations
from leadline.errors import InputError
from leadline.geometry import Beam
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.samples import Array, Sample

LASER = (*ORIGIN, *DIRECTION, "laser.range_scale", "laser.range_offset_m")
ALONG_SIGMA_M = 0.05
SCALE_SIGMA = 0.02
GAIN_OFF = 0.06
MEET_PX = 1.5
MIN_SPREAD_M = 0.1
_WEAK = 1.0  # metres across, radians, metres of offset: nothing known


def calibrate_laser(
    samples: Iterable[Sample], rig: Rig, *, medium: str = "air", air_port: str = "without", method: str = "ml"
) -> BeamFit:
    """The rig with its laser as measured in ``medium`` ("air" or "water"), from a static dive.

    air_port: whether the air images were taken "without" or "with" the housing. method: "ml", or "paper" (eq. 17-18).
    The rig's own covariance is held, not changed, and goes into the laser's. InputError says what the dive lacks.
    """
    there = rig_in_medium(rig, medium, air_port)
    found = sightings(samples)
    stations = find_stations(found, there, medium)
    start = _first_beam(there, stations, rig.laser)
    known = rig.covariance if rig.water is None else with_group_index(rig.covariance)
    fit = _paper_fit(start, stations) if method == "paper" else _ml_fit(start, stations, known)
    unseen = tuple((f.name, "no spot of the beam in both images") for f in found if not _used(f, stations))
    return dataclasses.replace(fit, rig=_brought_home(fit.rig, rig), left_out=unseen + fit.left_out)


def rig_in_medium(rig: Rig, medium: str, air_port: str = "without") -> Rig:
    """The rig as it stood in the calibration's medium. InputError where it cannot have been there."""
    if medium == "water":
        if rig.port is None or rig.water is None:
            raise InputError(
                "the rig has no port, so its water is not known", "", "calibrate the cameras in water first"
            )
        return rig
    if rig.port is None or air_port == "without":
        return dataclasses.replace(rig, port=None, water=None, laser=_in_air(rig.laser))
    port = dataclasses.replace(rig.port, outside_index=1.0)
    return dataclasses.replace(rig, port=port, water=None, laser=_in_air(rig.laser))


def find_stations(
    found: Sequence[Sighting], rig: Rig, medium: str, *, gain_off: float = GAIN_OFF, meet_px: float = MEET_PX
) -> list[Station]:
    """The spots that lie on one beam; InputError says why there are none."""
    if not any(f.left and f.right for f in found):
        raise InputError("no spot in any image", "", "the laser's green spot must be seen by both cameras")
    raw_m = np.array([f.raw_m for f in found])
    if np.ptp(raw_m) < MIN_SPREAD_M:
        raise InputError(
            f"all readings are {raw_m.min():.2f}-{raw_m.max():.2f} m: one distance does not show the beam's direction",
            "",
            "take stations spread over the working range, the farthest at least twice the nearest",
        )
    gain = rig.water.group_index if rig.water is not None else 1.0
    stations = spot_stations(found, rig, gain, gain_off=gain_off, meet_px=meet_px)
    if stations:
        return stations
    elsewhere = spot_stations(found, rig, 1.4, gain_off=0.6, meet_px=3 * meet_px)
    if len(elsewhere) >= 3:
        seen = _gain(elsewhere, rig)
        raise InputError(
            f"the readings grow by {seen:.2f} m a metre where {gain:.2f} is expected in {medium}",
            "",
            "check --medium, the rig, and that it is calibrated for where the dive was made",
        )
    raise InputError(
        f"no three of {len(found)} frames show a spot on one straight beam",
        "",
        "check that the spot is in both pictures, and that the rig belongs to these cameras",
    )


def _used(found: Sighting, stations: Sequence[Station]) -> bool:
    return any(station.name == found.name for station in stations)


def _points(rig: Rig, stations: Sequence[Station]) -> Array:
    left, right = np.array([s.left.q_px for s in stations]), np.array([s.right.q_px for s in stations])
    points, _ = rig.triangulate(left, right)
    return points


def _gain(stations: Sequence[Station], rig: Rig) -> float:
    points = _points(rig, stations)
    farthest = int(np.argmax([s.raw_m for s in stations]))
    nearest = int(np.argmin([s.raw_m for s in stations]))
    length = float(np.linalg.norm(points[farthest] - points[nearest]))
    return (stations[farthest].raw_m - stations[nearest].raw_m) / length


def _in_air(beam: Beam | None) -> Beam | None:
    return None if beam is None else dataclasses.replace(beam, group_index=1.0)


def _first_beam(rig: Rig, stations: Sequence[Station], before: Beam | None) -> Rig:
    """The line through the spots' points; its origin abreast of where the rig had it, or of the left pupil."""
    points = _points(rig, stations)
    middle = points.mean(axis=0)
    direction = np.linalg.svd(points - middle)[2][0]
    raw_m = np.array([s.raw_m for s in stations])
    direction = direction * np.sign((points - middle) @ direction @ (raw_m - raw_m.mean()))
    abreast = np.zeros(3) if before is None else before.origin_m
    origin = middle + ((abreast - middle) @ direction) * direction
    group = rig.water.group_index if rig.water is not None else 1.0
    scale = 1.0 if before is None else before.range_scale
    offset = float(np.median(raw_m - scale * group * ((points - origin) @ direction)))
    sigma = reading_sigma(stations, 0.003 if before is None else before.range_sigma_m)
    return dataclasses.replace(rig, laser=Beam(origin, direction, scale, offset, group, range_sigma_m=sigma))


def reading_sigma(stations: Sequence[Station], otherwise: float) -> float:
    """Standard deviation of one reading, pooled over the stations' scatter."""
    weights = np.array([s.readings - 1 for s in stations if s.readings > 1])
    scatter = np.array([s.scatter_m for s in stations if s.readings > 1])
    if weights.sum() < 5:
        return otherwise
    return max(float(np.sqrt(np.sum(weights * scatter**2) / weights.sum())), 0.0003)


def laser_prior(rig: Rig, cameras: RigCovariance) -> RigCovariance:
    """What is uncertain before the fit: the cameras as they are, and a laser of which only the rough kind is known."""
    assert rig.laser is not None
    names = tuple(n for n in cameras.names if not n.startswith("laser."))
    d = rig.laser.direction
    along = np.outer(d, d)
    block = np.zeros((len(LASER), len(LASER)))
    block[:3, :3] = _WEAK**2 * (np.eye(3) - along) + ALONG_SIGMA_M**2 * along
    block[3:6, 3:6] = _WEAK**2 * np.eye(3)
    block[6, 6], block[7, 7] = SCALE_SIGMA**2, _WEAK**2
    matrix = np.zeros((len(LASER) + len(names),) * 2)
    matrix[: len(LASER), : len(LASER)] = block
    matrix[len(LASER) :, len(LASER) :] = cameras.of(names)
    return RigCovariance(LASER + names, matrix)


def _ml_fit(rig: Rig, stations: Sequence[Station], cameras: RigCovariance) -> BeamFit:
    return fit_beam(rig, stations, LASER, laser_prior(rig, cameras))


def _brought_home(there: Rig, rig: Rig) -> Rig:
    """The laser and the covariance of the rig in the calibration's medium, put into the rig as it is used."""
    assert there.laser is not None
    group = rig.water.group_index if rig.water is not None else 1.0
    laser = dataclasses.replace(there.laser, group_index=group)
    return dataclasses.replace(rig, laser=laser, covariance=there.covariance)


def _paper_fit(rig: Rig, stations: Sequence[Station]) -> BeamFit:
    """Eq. 17-18 stacked over the distances: left pixels of the point L d + t, readings taken as they are."""
    assert rig.laser is not None
    measured = np.array([s.left.q_px for s in stations])
    group = rig.laser.group_index
    lengths = np.array([s.raw_m for s in stations]) / group

    def points(x: Array) -> Array:
        direction = np.array([x[0], x[1], np.sqrt(max(1 - x[0] ** 2 - x[1] ** 2, 1e-9))])  # eq. 16
        return np.asarray(x[2:] + lengths[:, None] * direction)

    def misses(x: Array) -> Array:
        return np.asarray(np.nan_to_num(rig.project(points(x))[0] - measured, nan=1e4).ravel())

    origin = rig.laser.origin_m + rig.laser.direction * (rig.laser.range_offset_m / group) * -1
    fit = least_squares(misses, [*rig.laser.direction[:2], *origin], x_scale="jac")
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    pixels = misses(fit.x)
    dof = max(len(pixels) - 5, 1)
    cov = np.linalg.pinv(jacobian.T @ jacobian) * float(pixels @ pixels) / dof
    direction = np.array([*fit.x[:2], np.sqrt(1 - fit.x[0] ** 2 - fit.x[1] ** 2)])
    lift = np.zeros((6, 5))
    lift[:3, 2:], lift[3:5, :2] = np.eye(3), np.eye(2)
    lift[5, :2] = -direction[:2] / direction[2]
    cov = lift @ cov @ lift.T
    laser = Beam(fit.x[2:], direction, 1.0, 0.0, group, range_sigma_m=rig.laser.range_sigma_m)
    found = dataclasses.replace(rig, laser=laser, covariance=RigCovariance(LASER[:6], (cov + cov.T) / 2))
    left, right = found.project(points(fit.x))
    seen = np.array([[*s.left.q_px, *s.right.q_px] for s in stations]) - np.hstack([left, right])
    none = np.zeros(len(stations))  # readings are taken as lengths
    return BeamFit(found, tuple(stations), (), seen, none, none, lengths, float(pixels @ pixels), dof)
