"""What the page of a report writes."""

from emoflow_ros.report.documents import format_count, format_number


def test_numbers_for_people():
    assert format_number(-1.234) == "\N{MINUS SIGN}1.23"
    assert format_number(float("nan")) == "\N{EN DASH}"
    assert format_number(None) == "\N{EN DASH}"
    assert format_number(2.0, 0) == "2"
    assert format_number(-0.001) == "0.00"
    assert format_count(1234567) == "1\N{NARROW NO-BREAK SPACE}234\N{NARROW NO-BREAK SPACE}567"
