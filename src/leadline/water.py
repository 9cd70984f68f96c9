"""How fast light goes in water: phase index (which bends rays) and group index (which delays a laser's pulse).

Quan & Fry, Applied Optics 34(18) 3477 (1995), fitted to 400-700 nm, 0-30 C and 0-35 psu, relative to AIR (Zhang & Hu,
Optics Express 17(3) 1671 (2009), multiply it by the index of air to get the index relative to vacuum). Relative to air
is what this project needs twice over: the camera's side of the port is air, and a rangefinder is set right in air.
"""

from __future__ import annotations

from dataclasses import dataclass

G_M_S2 = 9.80665
INDEX_PER_MPA = 1.5e-4
"""d(index)/d(pressure). Quan & Fry have no such term. Published slopes lie on both sides: 1.45e-4 in the deep-sea
neutrino telescopes' form of their formula (Schuster, thesis, Oxford 2002), 1.64e-4 in Waxler, Weir & Schamp (1964) at
1.6 C and 502 nm over the first 27 MPa; Millard & Seaver, Deep-Sea Research 37(12) 1909 (1990) fit all of it. At 100 m
the doubt is 2e-5, a tenth of what a calibration leaves."""

CHANNEL_NM = {"blue": 470.0, "green": 532.0, "red": 620.0}
"""The wavelength that stands for each colour channel of a camera."""

_RANGES = {
    "wavelength_nm": (400.0, 700.0),
    "temperature_c": (-2.0, 40.0),
    "salinity": (0.0, 42.0),
    "pressure_dbar": (0.0, 11000.0),
}


def refractive_index(wavelength_nm: float, temperature_c: float, salinity: float, pressure_dbar: float = 0.0) -> float:
    """Phase index of water relative to air. Salinity in psu, pressure in dbar above the surface's (about one a metre).

    ValueError outside 400-700 nm, -2-40 C, 0-42 psu or 0-11000 dbar (the source was fitted to 0-30 C and 0-35 psu).
    """
    constant, a1, a2, a3 = _series(wavelength_nm, temperature_c, salinity, pressure_dbar)
    w = wavelength_nm
    return constant + a1 / w + a2 / w**2 + a3 / w**3


def group_index(wavelength_nm: float, temperature_c: float, salinity: float, pressure_dbar: float = 0.0) -> float:
    """Group index n - w dn/dw (analytic) of water relative to air; arguments and errors as for ``refractive_index``."""
    constant, a1, a2, a3 = _series(wavelength_nm, temperature_c, salinity, pressure_dbar)
    w = wavelength_nm
    return constant + 2 * a1 / w + 3 * a2 / w**2 + 4 * a3 / w**3


def _series(wavelength_nm: float, temperature_c: float, salinity: float, pressure_dbar: float) -> tuple[float, ...]:
    """The index as a series in 1/w: constant, a1, a2, a3."""
    given = (wavelength_nm, temperature_c, salinity, pressure_dbar)
    for (name, (low, high)), value in zip(_RANGES.items(), given, strict=True):
        if not low <= value <= high:
            raise ValueError(f"{name}: {value:g} is outside {low:g} to {high:g}")
    s, t = salinity, temperature_c
    constant = 1.31405 + (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2) * s - 2.02e-6 * t**2
    pressure_mpa = pressure_dbar / 100.0
    return constant + INDEX_PER_MPA * pressure_mpa, 15.868 + 0.01155 * s - 0.00423 * t, -4382.0, 1.1455e6


@dataclass(frozen=True, slots=True)
class WaterState:
    """Water as it is measured: temperature (C), salinity (psu) and depth (m). ValueError out of range."""

    temperature_c: float
    salinity: float = 0.0
    depth_m: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.depth_m <= 11000:
            raise ValueError(f"depth_m: {self.depth_m:g} is outside 0 to 11000")
        self.index(CHANNEL_NM["green"])

    @property
    def pressure_dbar(self) -> float:
        """Pressure above the surface's, from a mean density (fresh 1000, sea 1027 kg/m3): within 3 % to full depth."""
        return self.depth_m * (1000.0 + 0.77 * self.salinity) * G_M_S2 / 1e4

    def index(self, wavelength_nm: float) -> float:
        return refractive_index(wavelength_nm, self.temperature_c, self.salinity, min(self.pressure_dbar, 11000.0))

    def group_index(self, wavelength_nm: float) -> float:
        return group_index(wavelength_nm, self.temperature_c, self.salinity, min(self.pressure_dbar, 11000.0))


@dataclass(frozen=True, slots=True)
class Water:
    """The indices that a rig uses: one for each colour channel (geometry takes green) and the laser's group index.

    ``state`` is what they were computed from; None where they were fitted to images.
    """

    blue: float
    green: float
    red: float
    group_index: float
    state: WaterState | None = None

    @property
    def index(self) -> float:
        return self.green

    @classmethod
    def from_state(cls, state: WaterState, laser_nm: float = 532.0) -> Water:
        blue, green, red = (state.index(nm) for nm in CHANNEL_NM.values())
        return cls(blue, green, red, state.group_index(laser_nm), state)
