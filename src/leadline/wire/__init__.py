"""Formats and protocols that go both ways: dive folder, recording, solutions table."""
