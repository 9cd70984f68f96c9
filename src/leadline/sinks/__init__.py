"""Where a run goes: tables and recordings."""

from leadline.sinks.base import HealthSink, Sink
from leadline.sinks.csv import SolutionsCsv
from leadline.sinks.mcap import McapSink

__all__ = ["HealthSink", "McapSink", "Sink", "SolutionsCsv"]
