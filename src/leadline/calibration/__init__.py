"""Calibration: boards, cameras and port together, laser, range. Takes images and samples, knows no source."""
