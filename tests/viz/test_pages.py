from dataclasses import replace

from topobatch.topology.topomap import Closure
from topobatch.viz.pages import closure_texts, visits

S = 10**9


def test_visits_are_counted_by_junction(make_map) -> None:
    assert visits(make_map("a")).tolist() == [1, 1, 1, 1, 2, 1, 2, 2]  # 0, 1, 2, 4, 2, 3, 0, 1


def test_closures_are_told_by_junctions(make_map) -> None:
    topomap = make_map("a")
    phantom = Closure(10 * S, 999 * S, False, 1.0, "no junction")
    revised = Closure(11 * S, 12 * S, False, 1.0, "put off", revised=True)
    topomap = replace(topomap, closures=(*topomap.closures, phantom, revised))
    told = [q.text for q in closure_texts(topomap)]
    assert told == [
        "junction 0: visit 2 recognised as visit 1, +21.5 bits: the square closes",
        "junction 1 (visit 2) not taken for junction 2 (visit 1), -3.0 bits: "
        "2 | 1 have *other* branches",
        "a pass that is no junction not taken for junction 0 (visit 1), +1.0 bits: no junction",
    ]
