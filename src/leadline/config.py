"""Settings of a run: every number that a user may change, with its default and its bounds.

``leadline config dump`` prints them, ``--config FILE`` reads them, and a run saves the effective ones as ``config.yaml``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from leadline.errors import InputError

Positive = Annotated[float, Field(gt=0)]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DetectorConfig(Section):
    """Finding the target's box in the left image."""

    score: float = Field(0.3, ge=0, le=1, description="a box below this score is not a detection")
    nms_iou: float = Field(0.5, gt=0, le=1, description="of two boxes that overlap more, the better one stays")
    threads: int = Field(2, ge=1, description="threads of the ONNX runtime")


class Config(Section):
    detector: DetectorConfig = DetectorConfig()

    @classmethod
    def load(cls, path: Path) -> Config:
        """Read a YAML file; InputError names the key that is wrong."""
        try:
            return cls.model_validate(yaml.safe_load(path.read_text()) or {})
        except OSError as error:
            raise InputError("cannot be read", str(path), "check the path") from error
        except yaml.YAMLError as error:
            raise InputError("is not YAML", str(path), str(error).replace("\n", " ")) from error
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"]) or "the file"
            raise InputError(f"{key}: {first['msg']}", str(path), "see `leadline config dump` for the keys") from error

    def dump(self) -> str:
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
