"""Measurements to a state: one robust filter over position, velocity and shape."""

from leadline.estimation.filter import Estimate, Filter, FilterSettings

__all__ = ["Estimate", "Filter", "FilterSettings"]
