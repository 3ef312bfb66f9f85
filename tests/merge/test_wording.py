"""Numbers in words."""

from topobatch.merge.wording import told_bits


def test_bits_that_fall_short_are_seen_to_do_so():
    assert told_bits(30.0, 12.55) == "30.0 bits, 12.6 needed"
    assert told_bits(20.0, 20.04) == "20.00 bits, 20.04 needed"
