"""Time stamps as text: decimal seconds to integer nanoseconds and back, never through a float.

A double holds 1700000000.123456789 s only to 0.2 microseconds, and 0.4 not at all; solutions are matched to the source
by their stamp, so a stamp goes through unchanged. Digits beyond the nanosecond are rounded (half to even).
"""

from __future__ import annotations

import re
from decimal import Decimal

NS_PER_S = 1_000_000_000
MAX_S = 2**31  # ROS 2 stamps end here (2038); anything larger is milliseconds or nanoseconds by mistake
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)


def parse_stamp(text: str) -> int:
    """Decimal seconds -> nanoseconds. Raises ValueError with one clear line."""
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"'{text}' is not a time in seconds")
    seconds = Decimal(text)
    if abs(seconds) >= MAX_S:
        raise ValueError(f"{text} is too large for a time in seconds")
    return int((seconds * NS_PER_S).to_integral_value())


def format_stamp(t_ns: int) -> str:
    """Nanoseconds -> decimal seconds, the shortest text with at least one decimal: 400000000 -> '0.4', 0 -> '0.0'."""
    whole, fraction = divmod(abs(t_ns), NS_PER_S)
    digits = f"{fraction:09d}".rstrip("0") or "0"
    return f"{'-' if t_ns < 0 else ''}{whole}.{digits}"
