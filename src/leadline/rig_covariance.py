"""The covariance of a rig's parameters, by the names that they have in the rig file."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from leadline.samples import Array


@dataclass(frozen=True, slots=True, eq=False)
class RigCovariance:
    """Covariance of named parameters of the rig file; a parameter that is not named counts as exact."""

    names: tuple[str, ...] = ()
    matrix: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def of(self, names: tuple[str, ...]) -> Array:
        """The block (len(names), len(names)) for these names, zeros for those that are exact."""
        out = np.zeros((len(names), len(names)))
        known = [(i, self.names.index(name)) for i, name in enumerate(names) if name in self.names]
        if known:
            here, there = (list(column) for column in zip(*known, strict=True))
            out[np.ix_(here, here)] = self.matrix[np.ix_(there, there)]
        return out

    def root(self, names: tuple[str, ...]) -> Array:
        """A (k, k) with A A^T = ``of(names)``, which may be singular; an independent part a column."""
        cov = self.of(names)
        sigma = np.sqrt(np.diag(cov))
        unit = np.where(sigma > 0, sigma, 1.0)  # by the correlations: the units differ
        values, vectors = np.linalg.eigh(cov / np.outer(unit, unit))
        return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))

    def scaled(self, factor: float) -> RigCovariance:
        """The same for images resized by ``factor``: what is in pixels scales."""
        scale = np.array([factor if name.endswith("_px") else 1.0 for name in self.names])
        return RigCovariance(self.names, self.matrix * np.outer(scale, scale))
