"""Where a run goes: tables and recordings."""

from leadline.sinks.base import Sink
from leadline.sinks.csv import SolutionsCsv

__all__ = ["Sink", "SolutionsCsv"]
