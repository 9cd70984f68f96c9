"""Where a run goes: tables and recordings."""

from leadline.sinks.base import Sink

__all__ = ["Sink"]
