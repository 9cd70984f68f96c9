"""Where a run goes: tables and recordings."""

from leadline.sinks.base import CheckedSink, EventSink, HealthSink, Sink
from leadline.sinks.csv import SolutionsCsv
from leadline.sinks.mcap import McapSink

__all__ = ["CheckedSink", "EventSink", "HealthSink", "McapSink", "Sink", "SolutionsCsv"]
