"""The group index of the water, which readings grow by: what is known of it where the phase index is known."""

from __future__ import annotations

import numpy as np

from leadline.rig_covariance import RigCovariance

INDEX, GROUP = "water.index", "water.group_index"
GROUP_PER_INDEX = 1.12
"""Fresh to sea, or cold to warm, the group index moves by this times the phase index."""
LINK_SIGMA = 2e-4  # of the group index where the phase index is known


def with_group_index(cov: RigCovariance) -> RigCovariance:
    """The group index among the uncertain: where the phase index goes it follows."""
    if GROUP in cov.names:
        return cov
    row, variance = np.zeros(len(cov.names)), LINK_SIGMA**2
    if INDEX in cov.names:
        row = cov.matrix[cov.names.index(INDEX)] * GROUP_PER_INDEX
        variance += float(row[cov.names.index(INDEX)]) * GROUP_PER_INDEX
    matrix = np.block([[cov.matrix, row[:, None]], [row[None], np.array([[variance]])]])
    return RigCovariance((*cov.names, GROUP), matrix)
