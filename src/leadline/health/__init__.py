"""The parts' states, for the page, ROS 2, MAVLink, ``doctor`` and ``summary.json``: pure values, fed with what happens.

>>> health = Health([Part.LEFT, Part.RIGHT, Part.LASER])
>>> health.sample(sample, now_ns)      # every sample as it arrives
>>> health.tick(now_ns)                # nothing has come
>>> health.conditions                  # what stands now: part, state, since when, why, what to do
"""

from leadline.health.monitor import Health
from leadline.health.states import Condition, Part, State, Verdict

__all__ = ["Condition", "Health", "Part", "State", "Verdict"]
