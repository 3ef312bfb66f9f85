"""Numbers in words."""

from topobatch.merge.result import shown_lead
from topobatch.merge.wording import told_bits


def test_bits_that_fall_short_are_seen_to_do_so():
    assert told_bits(30.0, 12.55) == "30.0 bits, 12.6 needed"
    assert told_bits(20.0, 20.04) == "20.00 bits, 20.04 needed"


def test_a_lead_is_the_difference_of_what_is_shown():
    assert shown_lead(6.75, 6.24) == 0.6  # 6.8 and 6.2
    assert shown_lead(6.75, 6.24, 2) == 0.51
    assert shown_lead(4.04, 9.04) == -5.0
