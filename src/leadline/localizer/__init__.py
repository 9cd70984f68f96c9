"""Samples to solutions: ``Localizer`` is the door that all data of a dive goes through."""

from leadline.localizer.localizer import Localizer
from leadline.localizer.smoothing import SmoothingLocalizer

__all__ = ["Localizer", "SmoothingLocalizer"]
