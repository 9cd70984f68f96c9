"""Which cell learns which box, and how wrong it is: a heat around each box's centre, on the levels that fit its size.

The heat is CenterNet's (arXiv:1904.07850), on three levels instead of one. What a cell learns does not depend on what
it predicts, so that short trainings converge.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from leadline.training.network import STRIDES

# A level (stride) learns boxes whose side, the root of the area, is within these pixels; neighbours share the overlap.
LEVEL_SIDES_PX = ((0.0, 64.0), (48.0, 144.0), (112.0, 1e9))
LEAST_SPREAD_CELLS, SPREAD = 0.6, 0.1  # the heat's standard deviation: at least so many cells, else a part of the side
BOX_HEAT = 0.3  # cells at least this hot learn the box
BOX_WEIGHT = 3.0


def pair_iou(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """IoU and generalised IoU (arXiv:1902.09630) of boxes (..., 4) x0 y0 x1 y1, broadcast."""
    shared = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    hull = (torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    union = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1) - shared
    iou = shared / (union + 1e-9)
    return iou, iou - (hull - union) / (hull + 1e-9)


def heat_of(cells: Tensor, strides: Tensor, truth: Tensor) -> Tensor:
    """(M, N) heat in 0..1 of boxes ``truth`` (M, 4) on ``cells`` (N, 2) of ``strides`` (N,); 1 at the centre's cell."""
    side = (truth[:, 2:] - truth[:, :2]).clamp(min=1).prod(-1).sqrt()[:, None]
    away = (cells[None] - (truth[:, None, :2] + truth[:, None, 2:]) / 2).abs()
    spread = torch.maximum(LEAST_SPREAD_CELLS * strides[None], SPREAD * side)
    heat = torch.exp(-((away / spread[..., None]) ** 2).sum(-1) / 2)
    fits = torch.zeros_like(heat, dtype=torch.bool)
    for stride, (least, most) in zip(STRIDES, LEVEL_SIDES_PX, strict=True):
        fits |= (strides[None] == stride) & (side >= least) & (side < most)
    heat = torch.where(fits, heat, torch.zeros_like(heat))
    at_centre = (away <= strides[None, :, None] / 2).all(-1) & fits
    return torch.where(at_centre, torch.ones_like(heat), heat)


def detection_loss(
    logits: Tensor, boxes: Tensor, cells: tuple[Tensor, Tensor], truths: list[Tensor], classes: list[Tensor]
) -> Tensor:
    """Scalar loss of a batch: logits (B, N, C), boxes (B, N, 4), cells' centres (N, 2) and strides (N,).

    ``truths`` (M, 4) and ``classes`` (M,) of each image. Inside a box of class -1 a target may be that nobody labelled:
    no cell there is taught to be empty.
    """
    target = torch.zeros_like(logits)
    taught = torch.ones_like(logits)
    quality = torch.ones_like(logits)
    box_loss, box_weight = logits.sum() * 0, logits.new_zeros(())
    for k, (every, numbers) in enumerate(zip(truths, classes, strict=True)):
        truth, names, unsure = every[numbers >= 0], numbers[numbers >= 0], every[numbers < 0]
        if len(unsure):
            hidden = ((cells[0][None] > unsure[:, None, :2]) & (cells[0][None] < unsure[:, None, 2:])).all(-1).any(0)
            taught[k, hidden] = 0
        if len(truth) == 0:
            continue
        heat = heat_of(*cells, truth)
        for number in names.unique():
            target[k, :, number] = heat[names == number].amax(0)
        taught[k][target[k] == 1] = 1
        hottest, owner = heat.max(0)
        mine = hottest >= BOX_HEAT
        iou, giou = pair_iou(boxes[k, mine], truth[owner[mine]])
        quality[k, mine] = (1 + iou.detach()[:, None]) / 2
        box_loss = box_loss + ((1 - giou) * hottest[mine]).sum()
        box_weight = box_weight + hottest[mine].sum()
    return _heat_loss(logits, target, quality, taught) + BOX_WEIGHT * box_loss / box_weight.clamp(min=1)


def _heat_loss(logits: Tensor, target: Tensor, quality: Tensor, taught: Tensor) -> Tensor:
    """At a centre cross entropy, elsewhere focal loss, which counts the less the hotter an empty cell is.

    At a centre the score shall be ``quality``, which grows with the overlap of the box predicted there
    (arXiv:2006.04388): boxes that fit well then rank first. No focal factor there (as in arXiv:2008.13367): with it
    scores stop half way, at 0.5 to 0.8, and a target ranks no higher than what resembles one.
    """
    score = logits.sigmoid()
    at_centre = target == 1
    full = -functional.binary_cross_entropy_with_logits(logits, quality, reduction="none")
    empty = (1 - target) ** 4 * score**2 * functional.logsigmoid(-logits)
    return -(torch.where(at_centre, full, empty) * taught).sum() / at_centre.sum().clamp(min=1)
