"""The one loop that every run goes through, and how its parts are put together."""

from leadline.pipeline.build import Job, build_job
from leadline.pipeline.loop import Report, run

__all__ = ["Job", "Report", "build_job", "run"]
