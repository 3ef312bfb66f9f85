"""What all formats have in common."""

from __future__ import annotations

from topobatch.topology.document import map_from_document, map_to_document
from topobatch.viz.exports import MAP_FORMATS

from .readers import BOUND_M


def test_the_same_map_gives_the_same_text(driven) -> None:
    again = map_from_document(map_to_document(driven[1]))
    for writers in MAP_FORMATS.values():
        for write in writers.values():
            assert write(driven[1], BOUND_M) == write(again, BOUND_M)
