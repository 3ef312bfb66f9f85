"""Tables, read by the csv module."""

from __future__ import annotations

from dataclasses import replace

from topobatch.viz.exports import MAP_FORMATS

from .readers import read_csv


def test_tables_have_a_row_for_everything(driven) -> None:
    junctions, corridors = (read_csv(w(driven[1], 0.1)) for w in MAP_FORMATS["csv"].values())
    assert [float(row["x"]) for row in junctions] == driven[1].xy[:, 0].tolist()
    assert [int(row["source"]) for row in corridors] == driven[1].source.tolist()
    assert sum(int(row["passes"]) for row in junctions) == len(driven[1].observation_vertex)
    site = replace(driven[1], info={"numbers": tuple(range(7, 7 + len(driven[1])))})
    assert read_csv(MAP_FORMATS["csv"][".junctions.csv"](site, 0.1))[1]["junction"] == "8"
    assert all(0.2 < float(row["speed_m_per_s"]) < 1.5 for row in corridors)


def test_formulas_in_tables_are_quoted(driven) -> None:
    kinds = ("=cmd|' /C calc'!A0", *driven[1].kind[1:])
    text = MAP_FORMATS["csv"][".junctions.csv"](replace(driven[1], kind=kinds), 0.1)
    assert read_csv(text)[0]["kind"] == f"'{kinds[0]}"
