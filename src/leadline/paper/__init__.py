"""The paper's own chain, with its own weaknesses: the yardstick beside our method. See ``docs/paper-method.md``.

Xu, Zheng, Tian, Zhang: "Study of Underwater Large-Target Localization Based on Binocular Camera and Laser Rangefinder".
"""

from leadline.paper.localizer import PaperLocalizer

__all__ = ["PaperLocalizer"]
