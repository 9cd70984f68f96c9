"""A recorded dive once it is over: each solution again, with all that was measured before and after it."""

from __future__ import annotations

from dataclasses import replace

from leadline.config import Config
from leadline.estimation import Filter, FilterSettings
from leadline.localizer.localizer import Localizer
from leadline.recognition.finder import Finder
from leadline.rig import Rig
from leadline.samples import Array, Sample, Solution
from leadline.target import Target, range_with_sigma


class SmoothingLocalizer(Localizer):
    """A localizer that keeps all of a dive, for ``smoothed``: its memory grows with the dive."""

    def __init__(
        self, rig: Rig, target: Target | None = None, detector: Finder | None = None, config: Config | None = None
    ) -> None:
        super().__init__(rig, target, detector, config)
        self._filter = Filter(FilterSettings(**self._config.filter.model_dump()), keep=True)
        self._told: list[tuple[Solution, Array | None]] = []  # with the covariance (3, 3) that no averaging removes

    def step(self, sample: Sample) -> Solution | None:
        solution = super().step(sample)
        if solution is not None:
            common = None
            if solution.cov_m2 is not None:
                common = solution.cov_m2 - self._counted.without(self._filter.at(solution.t_ns))[:3, :3]
            self._told.append((solution, common))
        return solution

    def smoothed(self) -> list[Solution]:
        """The solutions so far, in the same order, with their stamps, stages and statuses; lost ones as they were."""
        states = self._filter.smoothed()
        result = []
        for solution, common in self._told:
            estimate = None if common is None else states.at(solution.t_ns)
            if common is None or estimate is None:
                result.append(solution)
                continue
            cov = estimate.cov.copy()
            cov[:3, :3] += common
            range_m, sigma_m = range_with_sigma(self._target, estimate.x, cov)
            result.append(
                replace(
                    solution,
                    position_m=estimate.x[:3],
                    cov_m2=cov[:3, :3],
                    range_m=range_m,
                    range_sigma_m=sigma_m,
                    velocity_m_s=estimate.velocity_m_s,
                )
            )
        return result
