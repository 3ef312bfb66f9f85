"""What is said of the source of a map, whoever wrote its document."""

from __future__ import annotations

from topobatch.topology.made_from import describe_junctions, describe_unusual


def test_what_is_said_of_sources():
    assert describe_junctions({}) == ""
    assert describe_junctions({"source": {"junctions": {"topic": "/junctions"}}}) == ""
    told = {"topic": "/junctions", "passed_over": ["/scan"]}
    assert "from /junctions, not from /scan" in describe_junctions({"source": {"junctions": told}})
    both = {"source": {"junctions": told, "views": {"from": "scan", "topic": "/scan"}}}
    assert describe_junctions(both).endswith("; walls around places from /scan")
    alone = {"from": "scan", "topic": "/s", "drift_after_m": 0.3, "covered": 0.5, "odometry": False}
    map_info = {"source": {"junctions": alone}}
    told = "junctions from /s, drift in 20 m 0.30 m, 50 % of the way covered"
    assert describe_junctions(map_info) == told
    driven = {"way_m": 100.0, "corridors": 0.68, "out_and_back": 0.3, "ends": 0.02}
    assert describe_junctions(map_info | {"driven": driven}) == (
        told + ", 68 % of it along corridors or to turning points, "
        "30 % out of a junction and back to it"
    )
    all_there = {"way_m": 100.0, "corridors": 0.995, "out_and_back": 0.005, "ends": 0.0}
    assert (
        describe_junctions(map_info | {"driven": all_there})
        == told + ", 100 % of it along corridors or to turning points"
    )


def test_what_is_worse_than_usual():
    usual = {"from": "scan", "topic": "/s", "drift_after_m": 0.05, "covered": 1.0}
    info = {"source": {"junctions": usual}, "driven": {"corridors": 0.99}}
    assert describe_unusual(info) == describe_unusual({}) == describe_unusual({"source": 3}) == ""
    worse = usual | {"drift_after_m": 0.5, "covered": 0.8}
    assert describe_unusual({"source": {"junctions": worse}, "driven": {"corridors": 0.5}}) == (
        "drift in 20 m 0.50 m after matching scans (usually 0.12 m at most), "
        "scans cover 80% of the way, 50% of the way is on the map"
    )
