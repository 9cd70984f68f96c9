"""Which cell learns which box, and how wrong it is (task-aligned assignment, TOOD, arXiv:2108.07755)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

CANDIDATES = 9  # cells that learn one box
SCORE_POWER, IOU_POWER = 0.5, 4.0
IOU_WEIGHT = 2.5


def pair_iou(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """IoU and generalised IoU (arXiv:1902.09630) of boxes (..., 4) x0 y0 x1 y1, broadcast."""
    shared = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    hull = (torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    union = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1) - shared
    iou = shared / (union + 1e-9)
    return iou, iou - (hull - union) / (hull + 1e-9)


def assign(scores: Tensor, boxes: Tensor, cells: Tensor, truth: Tensor, classes: Tensor) -> tuple[Tensor, Tensor]:
    """For one image: each cell's box number (N,), -1 for none, and the score it should have (N,).

    ``scores`` (N, C), ``boxes`` (N, 4), ``cells`` (N, 2) centres, ``truth`` (M, 4), ``classes`` (M,).
    """
    inside = ((cells[None] > truth[:, None, :2]) & (cells[None] < truth[:, None, 2:])).all(-1)  # (M, N)
    iou = pair_iou(truth[:, None], boxes[None])[0] * inside
    metric = scores[:, classes].T.clamp(min=1e-6) ** SCORE_POWER * iou**IOU_POWER
    # A box so small that no prediction overlaps it yet still needs a teacher: its nearest cells.
    near = 1e-9 / (1 + (cells[None] - (truth[:, None, :2] + truth[:, None, 2:]) / 2).norm(dim=-1))
    ranked = metric + near * inside
    top = torch.zeros_like(inside).scatter_(1, ranked.topk(min(CANDIDATES, ranked.shape[1]), 1).indices, True) & inside
    claim = torch.where(top, ranked, torch.zeros_like(ranked))
    best, owner = claim.max(0)
    owner = torch.where(best > 0, owner, torch.full_like(owner, -1))
    mine = functional.one_hot(owner.clamp(min=0), len(truth)).T.bool() & (owner >= 0)  # (M, N)
    metric, overlap = metric * mine, iou * mine
    scale = overlap.amax(1, keepdim=True) / (metric.amax(1, keepdim=True) + 1e-12)
    return owner, (metric * scale).amax(0)


def detection_loss(logits: Tensor, boxes: Tensor, cells: Tensor, truths: list[Tensor], classes: list[Tensor]) -> Tensor:
    """Scalar loss of a batch: logits (B, N, C), boxes (B, N, 4), cells (N, 2); an image's truth (M, 4), classes (M,).

    Inside a box of class -1 a target may be that nobody labelled: no cell there is taught to be empty.
    """
    target = torch.zeros_like(logits)
    weight = torch.ones_like(logits)
    box_losses: list[Tensor] = []
    for k, (every, numbers) in enumerate(zip(truths, classes, strict=True)):
        truth, names, unsure = every[numbers >= 0], numbers[numbers >= 0], every[numbers < 0]
        if len(unsure):
            hidden = ((cells[None] > unsure[:, None, :2]) & (cells[None] < unsure[:, None, 2:])).all(-1).any(0)
            weight[k, hidden] = 0
        if len(truth) == 0:
            continue
        owner, wanted = assign(logits[k].detach().sigmoid(), boxes[k].detach(), cells, truth, names)
        mine = owner >= 0
        target[k, mine, names[owner[mine]]] = wanted[mine]
        weight[k, mine] = 1
        giou = pair_iou(boxes[k, mine], truth[owner[mine]])[1]
        box_losses.append((1 - giou) * wanted[mine].clamp(min=0.05))
    total = target.sum().clamp(min=1.0)
    # Quality focal weighting (arXiv:2006.04388): far off counts most, so the many empty cells do not drown the few.
    focus = (logits.detach().sigmoid() - target).abs() ** 1.5
    score_loss = (focus * weight * functional.binary_cross_entropy_with_logits(logits, target, reduction="none")).sum()
    box_loss = torch.cat(box_losses).sum() if box_losses else boxes.sum() * 0
    return (2.0 * score_loss + IOU_WEIGHT * box_loss) / total
