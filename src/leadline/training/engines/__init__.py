"""The trainers that ``leadline train`` can use, behind one interface."""

from leadline.training.engines.base import ENGINES, Engine, Epoch, Lesson, Progress, Quality, open_engine

__all__ = ["ENGINES", "Engine", "Epoch", "Lesson", "Progress", "Quality", "open_engine"]
