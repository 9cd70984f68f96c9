"""The embedded default simulator: scenes behind a flat port, a laser, a swaying vehicle, and the truth of all of it."""
