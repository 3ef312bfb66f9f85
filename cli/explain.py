"""`topobatch explain`: why the verdict on two runs is what it is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Annotated, Literal

from ..merge.decision import Decision, to_document
from ..merge.decision_text import lines
from ..merge.result import MergeResult, shown_bits
from ..topology.errors import UsageError
from ..topology.topomap import TopoMap
from ..topology.wording import counted
from .matching import kept_results, settings_of
from .options import RUNS, Extra, HereWithMerge, JsonOption, verb
from .output import say, say_json, say_lines, width
from .paper_options import PaperOptions
from .stale import changed_since, describe_changed
from .workspace import MERGED, Workspace

TO_MERGE = "topobatch merge --all"
"""What gives runs a verdict."""


@verb
def explain(
    a: Annotated[str, "A", "A run, or both as A:B.", RUNS],
    b: Annotated[str | None, "B", "Another run.", RUNS] = None,
    *,
    place: HereWithMerge,
    method: Annotated[
        Literal["robust", "paper"],
        "--method",
        "robust: the verdict, its evidence and threshold; paper: the tables and clusters of Huang "
        "& Beevers.",
    ] = "robust",
    paper: PaperOptions,
    as_json: JsonOption = False,
    rows: Annotated[
        int | None,
        "--rows N",
        "Links, or rows of a table and clusters, to print at most. Default: what fits a screen; 20 "
        "of the paper's.",
        Extra(min=1),
    ] = None,
) -> None:
    """Explain why two runs were merged, or not.

    The verdict; the placement with the matched junctions; the evidence for and against it, link by
    link, in bits; the threshold and what it is made of; the next best placement and its distance.
    With --method paper the figures of Huang & Beevers instead: the table of vertex pairs with the
    hypotheses they belong to (Fig. 1), the clusters in transform space (Fig. 2). topobatch draw A:B
    draws the evidence; a click on a pair in the report shows it as well.

    Runs that were not merged yet are explained by their two maps alone; a note says so.

    The paper's method takes the settings of merged.json, or of the merge that --merge names, if
    that is a merge by it, else the defaults; its options given here take the place of those.

    \b
      topobatch explain run1 run2
      topobatch explain run1 run2 --method paper --rows 5
    """
    if place.merge != MERGED:
        place.require_merge()
    if b is None:
        a, _, b = a.partition(":")
        if not b:
            raise UsageError("two runs are needed: topobatch explain A B")
    if a == b:
        raise UsageError(f"two runs are needed, got {a!r} twice")
    first, second = place.chosen_runs([a, b])
    if method == "paper":
        _by_paper(place, (first, second), paper, as_json, rows)
    else:
        paper.refuse()
        _by_evidence(place, (first, second), as_json, rows)


def _by_evidence(place: Workspace, pair: tuple[str, str], as_json: bool, rows: int | None) -> None:
    """Explain the decision of the robust method."""
    *_, decision = decided(place, pair)
    if as_json:
        say_json(to_document(decision))
        return
    # Pictures, which may be moved, have the call without the workspace.
    notes = [n.replace(TO_MERGE, place.call("merge", "--all")) for n in decision.notes]
    for line in lines(replace(decision, notes=tuple(notes)), rows, width()):
        say_lines(line)
    say(f"as a picture: {place.call('draw', ':'.join(pair), 'why.svg')}")


def decided(place: Workspace, pair: tuple[str, str]) -> tuple[TopoMap, TopoMap, Decision]:
    """The maps of a pair and the decision on it, with the settings and runs of the merge that had
    both. Without such a merge the decision is that of the two by themselves."""
    from ..merge.robust.explained import Merge, explain

    result = place.last_result()
    why_not = _not_merged(place, result, pair)
    settings, read = settings_of(place, result).robust, cache(place.read_map)
    kept = kept_results(place, settings)
    if result is None or why_not:
        runs = place.runs()
        merge = Merge(read, len(runs), {}, settings, place.locks(), kept=kept)
        notes = [
            f"{why_not}; this is what the two maps say by themselves, asked as one pair of "
            f"{counted(len(runs), 'map')}; a merge also counts what the others say"
        ]
    else:
        merge = Merge.of(result, read, settings, place.locks(), kept)
        new = changed_since(place, result, pair)
        notes = [f"{describe_changed(new)}; merge again"] if new else []
    decision = explain(merge, *pair)
    a, b = map(read, pair)
    notes += decision.notes
    return a, b, replace(decision, notes=tuple(notes), of_merge=decision.of_merge and not why_not)


def _not_merged(place: Workspace, result: MergeResult | None, pair: tuple[str, str]) -> str:
    """Why the workspace's merge has no verdict on a pair, "" if it has one."""
    if result is None:
        return f"not merged yet ({TO_MERGE})"
    name = place.merged_json.name
    if result.info.get("method") == "paper":
        return f"{name} is a merge by --method paper (see topobatch explain --method paper)"
    return "" if result.home.keys() >= {*pair} else f"{name} does not hold both runs"


def _by_paper(
    place: Workspace, pair: tuple[str, str], options: PaperOptions, as_json: bool, rows: int | None
) -> None:
    """Show the result of the paper's method."""
    from ..merge.paper.explain import explain as explained
    from ..merge.paper.explain import lines, to_document

    map_a, map_b = (place.read_map(run) for run in pair)
    settings = settings_of(place, place.last_result()).paper
    found = explained(map_a, map_b, options.over(settings))
    document = place.read_merged() if place.merged_json.is_file() else None
    entry = None if document is None else document.entry(*pair)
    if as_json:
        say_json(to_document(found) | {"verdict": entry and entry.model_dump()})
        return
    for line in lines(found, rows or 20):
        say_lines(line)
    if document is not None and entry is not None:
        by = f"{place.merged_json.name}, by the {document.graph.method} method"
        bits = f"{shown_bits(entry.evidence_bits)} bits: {entry.reason}"
        say(f"verdict of {by}: {entry.verdict}, {bits}")
