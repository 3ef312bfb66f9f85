import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from topobatch.merge.change import Change, ChangeKind, Witness
from topobatch.merge.decision import Decision, Placement, Requirement, Term
from topobatch.merge.drive import Drive, Stop
from topobatch.merge.result import Standing, UnlistedPairs
from topobatch.topology.matching.views import Compared
from topobatch.viz.report import Report, report_page

HOSTILE = "</script><img src=x onerror=alert(1)>&\"'{{7*7}}`${1}"
SEEN = Compared(np.eye(3)[:, :2], np.array([False, True, True]), np.arange(3))
VERSIONS = [("topobatch", "1.2.3")]


class Page(HTMLParser):
    """Tags with their attributes, the shown text, and the text of scripts by their id."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: dict[str, str] = {}
        self.text = ""
        self._script: str | None = None
        self.feed(html)

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag in ("script", "style"):
            self._script = dict(attrs).get("id") or f"{tag}-{len(self.scripts)}"

    def handle_endtag(self, tag) -> None:
        if tag in ("script", "style"):
            self._script = None

    def handle_data(self, data) -> None:
        if self._script is None:
            self.text += data
        else:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data

    @property
    def data(self):
        return json.loads(self.scripts["data-runs"])

    def sources(self, item: str) -> dict[str | None, list[dict]]:
        """The columns of a figure's renderers by their layers."""
        out: dict[str | None, list[dict]] = {}

        def walk(value) -> None:
            if isinstance(value, dict):
                if value.get("name") == "GlyphRenderer":
                    attributes = value["attributes"]
                    source = attributes["data_source"]["attributes"]["data"]
                    out.setdefault(attributes.get("name"), []).append(dict(source["entries"]))
                for part in value.values():
                    walk(part)
            elif isinstance(value, list):
                for part in value:
                    walk(part)

        walk(json.loads(self.scripts[f"data-{item}"]))
        return out


def page_of(result, maps, **fields) -> str:
    return report_page(Report({m.run: m for m in maps}, result, versions=VERSIONS, **fields))


def drive(component: int = 0, onto: str | None = "c", at=(0.0, 0.0)) -> Drive:
    stops = (Stop("north", 0, at), Stop("c", 12, (at[0] + 9.0, at[1])))
    path = np.array([at, stops[1].xy])
    return Drive(component, "north", onto, stops, path, 5.0, 9.0, (("a", "c"),), 18.0)


def change(**fields) -> Change:
    there, missing = Witness("a", 2, 1, 2), Witness("b", 3, 5, 6)
    given = {
        "thing": "corridor",
        "kind": ChangeKind.GONE,
        "component": 0,
        "junctions": (0, 1),
        "xy": (5.0, 0.0),
        "length": 10.0,
        "there": (there,),
        "missing": (missing,),
        "bits": 30.0,
        "needed": 9.0,
        "edge": 0,
    }
    return Change(**given | fields)


def decision(pair) -> Decision:
    terms = (
        Term("corridor", 3.5, "corridor", (0, 1), (0, 1), (10.0, 10.1)),
        Term("branches", 1.0, "branches", (0,), (0,)),
        Term("unseen", -1.5, "junction unseen", (2,), ()),
        Term("views", 3.0, "1 pair of views", (1,), (1,), seen=SEEN),
    )
    placed = [Placement(replace(x, evidence_bits=6.0), terms) for x in (pair.best, pair.runner_up)]
    need = Requirement(12.6, 6, 0.001, 3, 4.0, 2.5)
    return Decision(pair, True, need, tuple(placed), notes=("merge again",))


def named(result):
    sites = (replace(c, site=f"site {c.id}") for c in result.components)
    return replace(result, components=tuple(sites))


def test_the_page_answers_first(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"], ["d"]], [("a", "c")])
    page = Page(page_of(named(result), maps, drives=[drive()], changes=[change()]))
    told = " ".join(page.text.split())
    for sentence in (
        "2 of 4 runs are of 1 site: site 0 (2).",
        "2 runs stand alone: c (site 1), d (site 2).",
        "1 pair of runs is open (ambiguous).",
        "To record next: 9 m in north, from junction 0 towards c:12; it joins north and c, if "
        "they are one place: settles 1 open pair.",
        "1 change between runs.",
        "take care",
    ):
        assert sentence in told, sentence


def test_runs_that_were_not_merged_yet_are_told(make_map, empty_map) -> None:
    page = Page(page_of(None, [make_map("a"), empty_map]))
    assert "2 runs, not merged yet: topobatch merge --all." in page.text
    assert "Pairs of runs" not in page.text
    assert "map" in page.data["runs"][0]
    assert "0 runs, not merged yet" in page_of(None, [])


def test_the_page_holds_drives_changes_health_settings_versions(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"]])
    html = page_of(
        named(result),
        maps,
        drives=[drive()],
        changes=[change(), change(bits=1.0, junctions=(1, 2))],
        locks=["a + d: never"],
        warnings=["The map of x cannot be read"],
    )
    told = " ".join(Page(html).text.split())
    for part in (
        "by junctions 0; in c: 12",
        "18.0 bits expected",
        "Gone: corridor of 10.0 m between junctions 0 and 1 of site 0, at (5.0, 0.0) m. Last found "
        "1970-01-01 00:00 (a), first missing 1970-01-01 00:00 (b). Driven by a; missing for b in 3 "
        "passes. Evidence 30.0 bits, 9.0 needed.",
        "The map of x cannot be read",
        "first pass (UTC)",
        "2 messages were empty",
        "a + d: never",
        "topobatch 1.2.3",
    ):
        assert part in told, part
    assert "junctions 1 and 2" not in told  # may be chance


def test_the_same_report_is_the_same_page(merge_of, monkeypatch) -> None:
    result, maps = merge_of([["a", "b"], ["c"]])
    page_of(result, maps)  # what is imported for the first one takes numbers as well
    pages = set()
    for own in (maps, maps[::-1]):
        monkeypatch.setattr("bokeh.util.serialization._simple_id", 999)  # as in a new process
        pages.add(page_of(result, own))
    assert len(pages) == 1


def test_a_site_has_layers_and_says_what_is_clicked(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"]])
    page = Page(page_of(named(result), maps, drives=[drive()], changes=[change()]))
    layers = page.sources("site-0")
    assert {
        "branch never driven",
        "gone, with its number in the list",
        "drive to record, from its number on",
        "junction seen by several runs",
        "numbers",
    } <= set(layers)
    (strands,) = layers["a"]
    assert strands["lines"][0] == "Corridor 0 to 1: 10.00 ± 0.10 m, driven 2 times by a, b"
    assert len(strands["xs"]) == len(layers["b"][0]["xs"]) == 5
    (dots,) = layers["junction seen by several runs"]
    assert dots["lines"][0].startswith(
        "Junction 0: 3 branches, 1 pass by a (its 0), b (its 0); at (0.00, 0.00) m"
    )
    (gone,) = layers["gone, with its number in the list"]
    assert gone["lines"][0].startswith("Gone: corridor")
    assert {t for d in layers["numbers"] for t in d["text"]} == {*"01234", *"xy", "12", "drive 1"}
    assert "data-site-1" not in page.scripts  # it stands alone: its run's own map is there


def test_changes_are_numbered_throughout_all_sites(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c", "d"]])
    html = page_of(named(result), maps, changes=[change(component=1), change()])
    found = re.findall(r'<li value="(\d)">Gone: .* of site (\d)', html)
    assert found == [("1", "0"), ("2", "1")]
    numbers, *_ = Page(html).sources("site-1")["numbers"]
    assert numbers["text"] == ["2"]
    assert page_of(named(result), maps).count("Nothing changed") == 2
    none = np.zeros(0, np.int64)
    saved = replace(maps[0], traversal_ns=None, observation_vertex=none, observation_time_ns=none)
    html = page_of(named(result), [saved, *maps[1:]])
    assert (html.count("Nothing changed"), html.count("Saved maps tell")) == (1, 1)


def test_every_pair_is_in_the_page_with_its_reason(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"]], [("b", "c")])
    pair = next(v for v in result.verdicts if v.standing is Standing.AMBIGUOUS)
    said = "record with b's robot the corridor that c drove from its junction 0 to 1 (10.0 m): go"
    pair = replace(pair, advice=said)
    result = replace(result, verdicts=[pair if v.b + v.a == "cb" else v for v in result.verdicts])
    data = Page(page_of(result, maps, decisions={("b", "c"): decision(pair)})).data
    assert [run["name"] for run in data["runs"]] == ["a", "b", "c"]
    told = {
        (p["i"], p["j"]): (data["standings"][p["s"]], p["bits"], data["reasons"][p["r"]])
        for p in data["pairs"]
    }
    assert told == {
        (0, 1): ("merged", "40.0", "all fits"),
        (0, 2): ("unrelated", "-2.0", "nothing fits"),
        (1, 2): ("ambiguous", "39.0", "two ways"),
    }
    opened = {(p["i"], p["j"]): p for p in data["pairs"]}
    assert "rows" not in opened[0, 1]
    assert len(opened[0, 1]["placed"]) == 2
    shown = opened[1, 2]
    assert shown["placed"][0]["links"] == [[0, 1]]
    ((told, url),) = shown["placed"][0]["views"]
    assert told == "views for it: +3.0 bits"
    assert url.startswith("data:image/png;base64,")
    assert any(row[1:4] == ["corridor: 10.00 m, 10.10 m", "0-1", "0-1"] for row in shown["rows"])
    assert "Note: merge again" in shown["lines"]
    assert any(f"To settle it: {said}" in line for line in shown["lines"])
    side, ends, (xs, _) = shown["record"]
    assert (side, ends, len(xs)) == (1, [0, 1], 1)
    assert any(
        line.startswith("12.6 bits needed: log2(6 pairs / rate 0.001)") for line in shown["lines"]
    )
    sums = [row[-2] for row in shown["rows"] if row[0] == 0]
    assert sum(map(float, filter(None, sums))) == pytest.approx(6.0)


def test_a_pair_is_opened_in_the_order_of_its_verdict_whichever_site_comes_first(merge_of) -> None:
    """Its second run is placed in the frame of the first, also where the rows are the other way
    round."""
    result, maps = merge_of([["a"], ["b", "c"]], [("a", "c")])
    data = Page(page_of(result, maps)).data
    names = [run["name"] for run in data["runs"]]
    assert names == ["b", "c", "a"]
    pairs = {(names[p["i"]], names[p["j"]]) for p in data["pairs"]}
    assert pairs == {(pair.a, pair.b) for pair in result.verdicts}


def test_a_time_line_of_two_decades_shows_the_runs_of_either(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"]])
    old = [replace(m, observation_time_ns=m.observation_time_ns + 10**18) for m in maps[:1]]
    page = page_of(result, [*old, *maps[1:]])
    wide = [float(share) for share in re.findall(r"left:[\d.]+%;width:([\d.]+)%", page)]
    assert len(wide) == 3
    assert min(wide) > 10


def test_the_time_line_says_which_maps_it_lacks(merge_of) -> None:
    result, (first, *others) = merge_of([["a", "b"], ["c"]])
    none = np.zeros(0, np.int64)
    grid = replace(first, observation_time_ns=none, observation_vertex=none)
    told = Page(page_of(result, [grid, *others])).text
    assert "Without a time: 1 saved map." in told
    assert told.count("°/√m") == 2  # nor has it any noise
    assert "Without a time" not in Page(page_of(result, [first, *others])).text


def test_where_no_drive_is_worth_it_the_page_says_what_nobody_drove(merge_of) -> None:
    page = Page(
        page_of(*merge_of([["a", "b"]]), unexplored=["nothing to record", "  a: 1 junction: 3"])
    )
    assert "What to record next" in page.text
    assert "Nothing to record" in page.text
    assert "a: 1 junction: 3" in page.text


def test_nothing_is_fetched_and_no_name_is_markup(merge_of) -> None:
    result, maps = merge_of([[f"a{HOSTILE}", "b"], ["c"]])
    pair = replace(result.verdicts[0], reason=HOSTILE, advice=HOSTILE)
    result = replace(named(result), verdicts=(pair, *result.verdicts[1:]))
    result = replace(result, info={"warnings": [HOSTILE], "settings": {HOSTILE: HOSTILE}})
    sites = tuple(replace(c, site=HOSTILE) for c in result.components)
    source = {"junctions": {"from": "scan", "topic": HOSTILE}}
    info = {"source": source, "warnings": [HOSTILE], "settings": {HOSTILE: HOSTILE}}
    maps[0] = replace(maps[0], info=info)
    html = page_of(
        replace(result, components=sites),
        maps,
        locks=[HOSTILE],
        warnings=[HOSTILE],
        drives=[replace(drive(), site=HOSTILE, onto=HOSTILE)],
        changes=[change(there=(Witness(HOSTILE, 1, 1, 1),))],
    )
    page = Page(html)
    assert not [tag for tag, _ in page.tags if tag in ("img", "iframe", "object", "base", "link")][
        1:
    ]
    assert "{{7*7}}" in page.text
    assert page.data["runs"][0]["name"] == f"a{HOSTILE}"
    code = [text for name, text in page.scripts.items() if name.startswith("script-")]
    assert len(code) == 2
    assert not any("onerror" in text and "alert(1)" in text for text in code)
    for tag, attributes in page.tags:
        assert not any(name.startswith("on") for name in attributes), (tag, attributes)
        for name in ("src", "href", "srcset", "action"):
            target = attributes.get(name) or "#"
            assert target[0] == "#" or target == "data:,", (tag, target)
    assert not re.search(r"url\((?!#)", page.scripts["style-0"])
    assert "@import" not in page.scripts["style-0"]


def test_only_the_scripts_of_the_page_may_run(merge_of) -> None:
    page = Page(page_of(*merge_of([["a", "b"]])))
    (policy,) = [a["content"] for tag, a in page.tags if a.get("http-equiv")]
    assert "default-src 'none'" in policy
    assert "unsafe-eval" not in policy
    allowed = re.search("script-src([^;]*)", policy)[1].split()
    code = [text for name, text in page.scripts.items() if name.startswith("script-")]
    digests = [base64.b64encode(hashlib.sha256(c.encode()).digest()).decode() for c in code]
    assert allowed == [f"'sha256-{digest}'" for digest in digests]


def test_the_page_of_a_large_fleet_stays_small(merge_of) -> None:
    result, maps = merge_of([[f"run{k:03d}" for k in range(100)], *([f"x{k}"] for k in range(100))])
    html = page_of(result, maps)
    assert len(Page(html).data["pairs"]) == 19_900
    assert len(html) < 15_000_000


def test_pairs_that_a_large_merge_only_counts_are_counted(merge_of) -> None:
    result, maps = merge_of([["a", "b", "c"], ["d"]], [("a", "d")])
    kept = tuple(p for p in result.verdicts if (p.a, p.b) in {("a", "b"), ("b", "c"), ("a", "d")})
    counted = replace(
        result, verdicts=kept, unlisted=UnlistedPairs(joined=1, unrelated=0, screened=2)
    )
    page = Page(page_of(counted, maps))
    assert "joined through others (1)" in page.text
    assert "unrelated (2)" in page.text
    assert page.data["counted"] is True
    homes = [run["site"] for run in page.data["runs"]]
    assert len(set(homes[:3])) == 1 != len(set(homes))
