"""The boards that a calibration has seen: pairs of corner sets with a name and a medium; parameters by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from leadline.calibration.board import Board, Corners, alike
from leadline.calibration.problem import Sight
from leadline.rig import Side
from leadline.rig_derivatives import SIDES, Medium

__all__ = ["LAYER_NAMES", "PORT_NAMES", "POSE_NAMES", "SIDES", "BoardView", "lens_names", "numbered_alike", "sights_of"]

DISTORTION_TERMS = 5


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """One board in one or both cameras. ``name`` is the left image's (or the only image's)."""

    name: str
    medium: Medium
    left: Corners | None
    right: Corners | None = None

    def corners(self, side: Side) -> Corners | None:
        return self.left if side == "left" else self.right


def numbered_alike(views: Sequence[BoardView], board: Board) -> list[BoardView]:
    """Right corners numbered from the same end as the left's, where the board itself does not tell."""
    if not board.turns_into_itself:
        return list(views)
    return [
        view
        if view.left is None or view.right is None
        else BoardView(view.name, view.medium, view.left, alike(view.left, view.right))
        for view in views
    ]


def sights_of(views: Sequence[BoardView], board: Board) -> list[Sight]:
    """Every corner set as the bundle adjustment takes it; ``Sight.view`` is the place in ``views``."""
    return [
        Sight(i, side, view.medium, board.points_m[corners.ids], corners.pixels, board.bow[corners.ids])
        for i, view in enumerate(views)
        for side in SIDES
        if (corners := view.corners(side)) is not None
    ]


def lens_names(side: Side, terms: int = DISTORTION_TERMS) -> tuple[str, ...]:
    """The rig file's names of one camera's parameters."""
    focal = tuple(f"{side}.{key}" for key in ("fx_px", "fy_px", "cx_px", "cy_px"))
    return focal + tuple(f"{side}.distortion[{i}]" for i in range(terms))


POSE_NAMES = tuple(f"T_right_left.{key}[{i}]" for key in ("rotation_rad", "t_m") for i in range(3))
PORT_NAMES = ("port.normal[0]", "port.normal[1]", "port.distance_m")
LAYER_NAMES = ("port.layers[0].thickness_m", "port.layers[0].index")
