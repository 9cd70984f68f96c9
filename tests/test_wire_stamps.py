"""Stamps go through as text, exactly."""

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leadline.wire.stamps import MAX_S, NS_PER_S, format_stamp, parse_stamp

STAMPS = st.integers(-MAX_S * NS_PER_S + 1, MAX_S * NS_PER_S - 1)


@given(STAMPS)
def test_stamp_round_trip(t_ns: int) -> None:
    text = format_stamp(t_ns)
    assert parse_stamp(text) == t_ns
    assert Decimal(text) * NS_PER_S == t_ns  # the value is the decimal number, not only something we read back


@given(st.integers(0, MAX_S - 1), st.text("0123456789", max_size=9))
def test_decimal_text_keeps_its_value(whole: int, digits: str) -> None:
    text = f"{whole}.{digits}"
    assert Decimal(format_stamp(parse_stamp(text))) == Decimal(text)


@pytest.mark.parametrize(
    ("text", "t_ns", "written"),
    [
        ("0.4", 400_000_000, "0.4"),
        ("7.2", 7_200_000_000, "7.2"),
        ("0", 0, "0.0"),
        ("1700000000.123456789", 1_700_000_000_123_456_789, "1700000000.123456789"),
        ("-0.08", -80_000_000, "-0.08"),
        (" +1e-3 ", 1_000_000, "0.001"),
        ("0.30000000000000004", 300_000_000, "0.3"),  # beyond the nanosecond it is rounded
    ],
)
def test_known_stamps(text: str, t_ns: int, written: str) -> None:
    assert parse_stamp(text) == t_ns
    assert format_stamp(t_ns) == written


@pytest.mark.parametrize("text", ["", "abc", "nan", "inf", "1_000", "1,5", "0x10", "1700000000123", "1e300", "--1"])
def test_not_a_stamp(text: str) -> None:
    with pytest.raises(ValueError, match="time in seconds"):
        parse_stamp(text)
