"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import pytest

cv2.setNumThreads(1)  # the suite runs on several processes already


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The shared data sets: $LEADLINE_DATA, else ../shared/data beside the checkout. CI fails without them."""
    folder = Path(os.environ.get("LEADLINE_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        message = f"no data sets at {folder}; set LEADLINE_DATA"
        pytest.fail(message) if os.environ.get("CI") == "true" else pytest.skip(message)
    return folder
