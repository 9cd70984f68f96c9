"""The filter's settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """``config.FilterConfig`` documents these."""

    model: Literal["velocity", "acceleration"] = "velocity"
    manoeuvre_s: float = 1.0
    acceleration_psd: float = 0.01  # m^2/s^3
    adapt: bool = True
    initial_speed_m_s: float = 0.4
    gate_sigmas: float = 5.0
    student_nu: float = 4.0
    horizon_s: float = 2.0
    recover_after: int = 3
    recover_after_s: float = 0.3
    laser_clock_sigma_s: float = 0.05
