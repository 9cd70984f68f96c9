"""How a detector is trained: the paper's recipe, and what it leaves open."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from leadline.config import Section

# Where Ultralytics' own recipe, which the paper used, differs from ours: a mosaic always, larger images, no early stop.
OTHERS = {"yolov8n": {"mosaic": 1.0, "size": 640, "patience": 0}}


class TrainConfig(Section):
    """Settings of ``leadline train``, written beside the result as ``settings.yaml``."""

    engine: Literal["leadline", "yolov8n"] = Field("leadline", description="what is trained, and by whom")
    epochs: int = Field(50, ge=1, description="an epoch shows as many pictures as the training part has (the paper's)")
    batch: int = Field(4, ge=1, le=256, description="pictures a step (the paper's)")
    mosaic: float = Field(0.5, ge=0, le=1, description="share of pictures made of four (the paper's, its share ours)")
    plain_end: float = Field(0.2, ge=0, le=1, description="the last part of the training sees no mosaic")
    size: int = Field(416, ge=64, le=1920, multiple_of=32, description="long side of the network's input, pixels")
    learning_rate: float = Field(2e-3, gt=0, le=1, description="its greatest, of leadline's engine; it falls to 2 %")
    patience: int = Field(20, ge=0, description="stop after so many epochs without a better AP50-95; 0: never")
    minutes: float | None = Field(None, gt=0, description="be done by then, whatever the epochs")
    seed: int = Field(0, ge=0, description="of the split, the first weights and the pictures")
    threads: int = Field(2, ge=1, description="threads of the processor")

    @model_validator(mode="before")
    @classmethod
    def _engines_own_defaults(cls, given: dict[str, Any]) -> dict[str, Any]:
        return {**OTHERS.get(str(given.get("engine")), {}), **given}
