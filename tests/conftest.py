"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import cv2
import pytest

cv2.setNumThreads(1)  # the suite runs on several processes already
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # so a shell starts what goes on in its background
    signal.signal(signal.SIGINT, signal.default_int_handler)  # else no program that a test starts could be interrupted


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The shared data sets: $LEADLINE_DATA, else ../shared/data beside the checkout. CI fails without them."""
    folder = Path(os.environ.get("LEADLINE_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        message = f"no data sets at {folder}; set LEADLINE_DATA"
        pytest.fail(message) if os.environ.get("CI") == "true" else pytest.skip(message)
    return folder
