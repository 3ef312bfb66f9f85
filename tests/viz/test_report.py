import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from topobatch.merge.result import Alignment, PairVerdict, Standing, Unlisted, Verdict
from topobatch.topology.turning_points import TURNING_POINT
from topobatch.viz.report import Report, report_page
from topobatch.viz.report_style import VERDICT_COLOURS
from topobatch.viz.report_verdicts import STANDINGS, pair_told
from topobatch.viz.verdicts import MergeLayers, merge_summary

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
HOSTILE = "</script><img src=x onerror=alert(1)>&\"'"
VERSIONS = [("topobatch", "1.2.3")]


class Page(HTMLParser):
    """Tags with their attributes, and the text of scripts."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.data = ""
        self._in_data = False
        self.feed(html)

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs)))
        self._in_data = dict(attrs).get("id") == "data"

    def handle_data(self, data) -> None:
        if self._in_data:
            self.data += data
            self._in_data = False


def page_of(result, maps, **fields) -> str:
    return report_page(Report({m.run: m for m in maps}, result, versions=VERSIONS, **fields))


def test_the_page_holds_summary_pictures_verdicts_health_settings_versions(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"], ["d"]], [("a", "c")])
    html = page_of(result, maps, locks=["a + d: never"], warnings=["The map of x cannot be read"])
    for told in (
        "<b>4</b>runs",
        "<th>first pass (UTC)</th>",
        "<b>1</b>pair ambiguous",
        "take care",
        "The map of x cannot be read",
        "<h2>Undecided: both placements</h2>",
        "next best: 39.0 bits",
        "To settle it: go on",
        "<h2>Verdicts</h2>",
        "2 messages were empty",
        "a + d: never",
        "topobatch 1.2.3",
    ):
        assert told in html, told
    assert page_of(result, maps, locks=["a + d: never"]) == page_of(
        result, list(reversed(maps)), locks=["a + d: never"]
    )


def test_ways_to_turning_points_are_no_corridors(merge_of, make_map, turned) -> None:
    result, _ = merge_of([["a", "b"]])
    fused = replace(result.fused, kind=(*result.fused.kind[:4], TURNING_POINT))
    html = page_of(replace(result, fused=fused), [turned(make_map(run)) for run in "ab"])
    assert "<b>32</b>m of corridors" in html
    assert "<b>6</b>m to turning points or ends of logs" in html
    assert (
        html.count("<td>4 (32 m)</td>") == html.count(">4 junctions, 4 corridors, 32 m, 1 way") == 2
    )
    page = merge_summary(replace(result, fused=fused), MergeLayers())
    assert "**4** corridors, 32 m, 1 way to turning points or ends of the log, 6 m" in page


def test_every_pair_is_in_the_page_with_its_reason(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"]], [("b", "c")])
    data = json.loads(Page(page_of(result, maps)).data)
    assert data["runs"] == ["a", "b", "c"]
    told = {
        (data["runs"][i], data["runs"][j]): (data["standings"][s], bits, data["reasons"][k])
        for i, j, s, bits, k in data["pairs"]
    }
    assert told == {
        ("a", "b"): ("merged", 40.0, "all fits"),
        ("a", "c"): ("unrelated", -2.0, "nothing fits"),
        ("b", "c"): ("ambiguous", 39.0, "two ways"),
    }


def test_pairs_that_a_person_locked_are_marked_in_the_matrix(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"]])
    assert "locked" not in page_of(result, maps)
    pair = replace(result.verdicts[1], evidence_bits=30.0, locked="never")
    locked = replace(result, verdicts=(result.verdicts[0], pair, *result.verdicts[2:]))
    html = page_of(locked, maps)
    assert "bits of evidence; locked: a person decided." in html
    assert html.count(">locked</text>") == 1
    legend = merge_summary(locked, MergeLayers(numbers=True))
    assert "bits of evidence; locked: a person decided." in legend


def test_what_components_needed_is_not_what_two_runs_need(merge_of) -> None:
    result, maps = merge_of([["a", "b"], ["c"]])
    first, *others = (replace(v, threshold_bits=12.6) for v in result.verdicts)
    first = replace(first, accepted_by="components", threshold_bits=10.0)
    result = replace(result, verdicts=(first, *others))
    assert "takes 12.6 bits" in page_of(result, maps)
    assert "Merging needs 12.6 bits." in merge_summary(result, MergeLayers())


def test_nothing_is_fetched_and_no_name_is_markup(merge_of) -> None:
    result, maps = merge_of([[f"a{HOSTILE}", "b"], ["c"]])
    pair = replace(result.verdicts[0], reason=HOSTILE, advice=HOSTILE)
    result = replace(result, verdicts=(pair, *result.verdicts[1:]), info={"warnings": [HOSTILE]})
    source = {"junctions": {"from": "scan", "topic": HOSTILE}}
    info = {"source": source, "warnings": [HOSTILE], "settings": {HOSTILE: HOSTILE}}
    maps[0] = replace(maps[0], info=info)
    html = page_of(result, maps, locks=[HOSTILE], warnings=[HOSTILE])
    page = Page(html)
    assert not [tag for tag, _ in page.tags if tag in ("img", "iframe", "object", "base")]
    assert sum(tag == "script" for tag, _ in page.tags) == 2
    assert f"a{HOSTILE}" in json.loads(page.data)["runs"]
    for tag, attributes in page.tags:
        assert not any(name.startswith("on") for name in attributes), (tag, attributes)
        for name in ("src", "href", "xlink:href", "srcset", "action"):
            target = attributes.get(name) or "#"
            assert target[0] == "#" or target == "data:,", (tag, target)
    assert not re.search(r"url\((?!#)", html)
    assert "@import" not in html


def test_source_and_warnings_of_a_run_stand_below_it_as_wide_as_the_table(merge_of) -> None:
    result, maps = merge_of([["a", "b"]])
    source = {"junctions": {"from": "scan", "topic": "/s", "covered": 0.9}}
    maps = [
        replace(maps[0], info={}),
        replace(maps[1], info={"source": source, "warnings": ["drifts", "jumps"]}),
    ]
    html = page_of(result, maps)
    table = html[html.index("<h2>Runs</h2>") :]
    table = table[: table.index("</table>")]
    assert table.count("<tr>") == 1 + len(maps) + 1
    told = "junctions from /s, 90 % of the way covered<br>drifts<br>jumps"
    assert f'<td class="told" colspan="{table.count("<th>")}">{told}</td>' in table
    assert table.index("<td>b</td>") < table.index("drifts")


def test_few_runs_have_a_small_matrix(merge_of) -> None:
    def width(runs: list[str]) -> float:
        found = re.search(r'id="matrix" style="max-width:(\d+)rem"', page_of(*merge_of([runs])))
        assert found is not None
        return float(found[1])

    assert width(["a", "b"]) < width(["a", "b", "c", "d"]) < width([f"run{k}" for k in range(30)])


def test_runs_that_were_not_merged_yet_are_told(make_map, empty_map) -> None:
    html = page_of(None, [make_map("a"), empty_map])
    assert "topobatch: 2 runs, not merged yet" in html
    assert "topobatch merge --all" in html
    assert "Verdicts" not in html
    result_page = page_of(None, [])
    assert "<b>0</b>runs" in result_page


def test_an_answer_that_was_taken_back_is_not_counted_as_refused(make_map) -> None:
    asked = make_map("a")
    back = replace(asked.closures[1], revised=True)
    shown = [
        page_of(None, [m]) for m in (asked, replace(asked, closures=(asked.closures[0], back)))
    ]
    cells = [re.findall(r"<td>([^<]*)</td>", html)[7:9] for html in shown]
    assert cells == [["1", "1"], ["1", "0"]]


def test_a_run_that_the_merge_left_out_is_told(merge_of, make_map) -> None:
    result, maps = merge_of([["a", "b"]])
    html = page_of(result, [*maps, make_map("late")])
    assert "Not in the last merge: late" in html


def test_a_pair_decided_on_maps_that_have_changed_is_told_but_not_drawn(merge_of) -> None:
    result, maps = merge_of([["a"], ["b"]], [("a", "b")])
    (pair,) = result.verdicts
    for part in (
        {"matched": np.array([[0, 99]])},
        {"contradictions": ("x",), "contradicting": (((99,), (0, 1)),)},
    ):
        other = replace(pair, best=replace(pair.best, **part))
        html = page_of(replace(result, verdicts=(other,)), maps)
        assert "<h2>Undecided" not in html
        assert "two ways" in html


def test_the_page_of_a_large_fleet_stays_small(merge_of) -> None:
    result, maps = merge_of([[f"run{k:03d}" for k in range(100)], *([f"x{k}"] for k in range(100))])
    html = page_of(result, maps)
    assert len(json.loads(Page(html).data)["pairs"]) == 19_900
    assert len(html) < 4_000_000


def test_pairs_that_a_large_merge_only_counts_are_counted(merge_of) -> None:
    result, maps = merge_of([["a", "b", "c"], ["d"]], [("a", "d")])
    kept = tuple(p for p in result.verdicts if (p.a, p.b) in {("a", "b"), ("b", "c"), ("a", "d")})
    counted = replace(result, verdicts=kept, unlisted=Unlisted(joined=1, screened=2))
    html = page_of(counted, maps)
    assert "<b>1</b>pair joined through others" in html
    assert "<b>2</b>pairs unrelated" in html
    assert "3 pairs more" in html
    joined = STANDINGS.index("joined through others")
    assert f'<path d="M0 0h3v3h-3z" fill="var(--v{joined})"/>' in html
    data = json.loads(Page(html).data)
    assert data["counted"] is True
    assert len(set(data["homes"][:3])) == 1 != len(set(data["homes"]))
    assert "pairs more" not in page_of(result, maps)


def test_what_speaks_against_the_next_best_placement_is_not_said_of_the_best() -> None:
    def placed(*against):
        matched = np.array([[0, 0]])
        return Alignment(np.zeros(3), 9.0, matched, 0.1, contradictions=against)

    told = pair_told(
        PairVerdict(
            *("a", "b", Verdict.AMBIGUOUS, False, 9.0, "0 contradict"),
            best=placed(),
            runner_up=placed("one lies in the other"),
        )
    )
    assert "<p>Against the next best placement: one lies in the other</p>" in told
    assert "Against it" not in told


def test_colours_stand_for_standings() -> None:
    assert tuple(VERDICT_COLOURS) == STANDINGS == tuple(map(str, Standing))


@pytest.mark.skipif(BROWSER is None, reason="there is no chromium here")
def test_a_browser_shows_the_matrix_and_the_lists(tmp_path: Path, merge_of) -> None:
    result, maps = merge_of([["a", f"b{HOSTILE}"], ["c"]])
    html = page_of(result, maps)
    probe = """<script>
    const errors=[];
    addEventListener("error",e=>errors.push(e.message));
    addEventListener("securitypolicyviolation",e=>errors.push(e.blockedURI));
    addEventListener("load",()=>setTimeout(()=>{
      const svg=document.querySelector("#matrix svg");
      const q=new DOMPoint(1.5,.5).matrixTransform(svg.getScreenCTM());
      svg.dispatchEvent(new MouseEvent("mousemove",{clientX:q.x,clientY:q.y,bubbles:true}));
      const told=document.getElementById("told").textContent;
      document.getElementById("theme").click();
      document.querySelectorAll("details").forEach(d=>d.open=true);
      setTimeout(()=>{
        const lines=[...document.querySelectorAll("details[data-standing] li")];
        document.body.replaceChildren(Object.assign(document.createElement("pre"),{textContent:
          "FOUND"+JSON.stringify({errors,told,theme:document.documentElement.dataset.theme,
          wide:document.documentElement.scrollWidth<=innerWidth,
          ink:getComputedStyle(document.documentElement).getPropertyValue("--c0"),
          lines:lines.map(l=>l.textContent)})}));
      },200);
    },100));
    </script>"""
    file = tmp_path / "report.html"
    file.write_text(html.replace("<main>", f"{probe}<main>", 1), encoding="utf-8")
    call = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    done = subprocess.run(
        [
            *call,
            f"--user-data-dir={tmp_path / 'profile'}",
            "--virtual-time-budget=5000",
            file.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    import html as entities

    found = json.loads(entities.unescape(re.search(r"FOUND(\{.*\})</pre>", done.stdout, re.S)[1]))
    assert found["errors"] == []
    assert found["told"] == f"a + b{HOSTILE}: merged, 40.0 bits: all fits"
    assert found["theme"] == "dark"
    assert found["ink"] == "#0f1115"
    assert found["wide"]
    assert [line.rpartition(": ")[2] for line in found["lines"]] == ["nothing fits"] * 2
