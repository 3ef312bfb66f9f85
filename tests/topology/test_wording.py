"""Names in messages."""

from __future__ import annotations

from topobatch.topology.wording import listed


def test_names_beyond_the_first_are_counted() -> None:
    assert listed([]) == ""
    assert listed(["a", "b"], 2) == "a, b"
    assert listed(["a", "b", "c", "d"], 2) == "a, b and 2 more"
    assert listed([str(k) for k in range(13)]).endswith("10, 11 and 1 more")
