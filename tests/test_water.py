"""Water: published values, the group index as a derivative, units and ranges."""

from __future__ import annotations

import math

import pytest

from leadline import water


@pytest.mark.parametrize(("salinity", "phase", "group"), [(0, 1.33504, 1.35656), (35, 1.34151, 1.36380)])
def test_indices_at_the_laser_s_wavelength(salinity: float, phase: float, group: float) -> None:
    assert round(water.refractive_index(532, 20, salinity), 5) == phase
    assert round(water.group_index(532, 20, salinity), 5) == group


def test_the_index_is_relative_to_air() -> None:
    """Pure water at the sodium line and 20 C: 1.33299 relative to air, 1.33336 relative to vacuum (handbook values)."""
    assert water.refractive_index(589.3, 20, 0) == pytest.approx(1.33299, abs=3e-5)


@pytest.mark.parametrize("wavelength_nm", [410.0, 532.0, 690.0])
@pytest.mark.parametrize("state", [(5.0, 0.0, 0.0), (20.0, 35.0, 0.0), (28.0, 12.0, 300.0)])
def test_group_index_is_phase_minus_wavelength_times_slope(wavelength_nm: float, state: tuple[float, ...]) -> None:
    h = 0.01
    slope = (water.refractive_index(wavelength_nm + h, *state) - water.refractive_index(wavelength_nm - h, *state)) / (
        2 * h
    )
    expected = water.refractive_index(wavelength_nm, *state) - wavelength_nm * slope
    assert water.group_index(wavelength_nm, *state) == pytest.approx(expected, abs=1e-9)


def test_pressure_raises_both_indices_by_15e_5_per_megapascal() -> None:
    for index in (water.refractive_index, water.group_index):
        assert index(532, 20, 0, 100.0) - index(532, 20, 0) == pytest.approx(1.5e-4, rel=1e-6)


def test_depth_becomes_pressure() -> None:
    assert water.WaterState(20, 0, 100).pressure_dbar == pytest.approx(98.07, abs=0.01)
    assert water.WaterState(20, 35, 100).pressure_dbar == pytest.approx(100.7, abs=0.1)
    deep = water.WaterState(20, 0, 101.97)
    assert deep.index(532) - water.WaterState(20).index(532) == pytest.approx(1.5e-4, rel=1e-3)


def test_a_rig_s_water_takes_green_and_disperses() -> None:
    fresh = water.Water.from_state(water.WaterState(20.0))
    assert round(fresh.index, 5) == 1.33504
    assert fresh.blue > fresh.green > fresh.red
    assert round(fresh.group_index, 5) == 1.35656


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("wavelength_nm", (1064, 20, 0)),
        ("temperature_c", (532, 293, 0)),
        ("salinity", (532, 20, -1)),
        ("salinity", (532, 20, 350)),
        ("pressure_dbar", (532, 20, 0, -5)),
        ("temperature_c", (532, math.nan, 0)),
    ],
)
def test_out_of_range_names_the_argument(name: str, arguments: tuple[float, ...]) -> None:
    for index in (water.refractive_index, water.group_index):
        with pytest.raises(ValueError, match=name):
            index(*arguments)


def test_a_state_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="depth_m"):
        water.WaterState(20, 0, -1)
    with pytest.raises(ValueError, match="salinity"):
        water.WaterState(20, 99)
