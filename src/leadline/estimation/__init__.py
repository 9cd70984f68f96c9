"""Measurements to a state: one robust filter over position, velocity and shape."""

from leadline.estimation.filter import Filter
from leadline.estimation.settings import FilterSettings
from leadline.estimation.smoother import Smoothed
from leadline.estimation.state import Estimate

__all__ = ["Estimate", "Filter", "FilterSettings", "Smoothed"]
