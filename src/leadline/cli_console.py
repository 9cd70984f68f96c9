"""Where tables and remarks are printed: what stands in them is a user's (paths, addresses), and stays as it is."""

from __future__ import annotations

from rich.console import Console


def open_console() -> Console:
    """Rich without its markup: `[left]` in a path is no style, `:x:` in an address no picture."""
    return Console(highlight=False, markup=False, emoji=False)
