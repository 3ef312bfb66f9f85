"""Numbers in words."""

from topobatch.merge.wording import told_bits, told_placement


def test_bits_that_fall_short_are_seen_to_do_so():
    assert told_bits(30.0, 12.55) == "30.0 bits, 12.6 needed"
    assert told_bits(20.0, 20.04) == "20.00 bits, 20.04 needed"


def test_a_placement_is_never_to_nothing():
    assert told_placement(0.234, 0.025) == "0.2 m and 1.4°"
    assert told_placement(0.0491, 0.0005) == "4.9 cm and 0.029°"
    assert told_placement(0.0004, 0.00174) == "0.04 cm and 0.1°"
