"""`topobatch explain`: why the verdict on two runs is what it is."""

from __future__ import annotations

import json
import shlex
from functools import cache
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..topology.errors import DocumentError, UsageError
from ..topology.wording import counted, listed
from .matching import kept_results
from .options import (
    DEFAULT_WORKSPACE,
    JsonOption,
    MergeOption,
    WorkspaceOption,
    complete_run,
    grouped,
)
from .output import say, say_lines, warn, width
from .paper_options import PaperOptions
from .workspace import MERGED, Workspace, pair_named

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from ..merge.decision import Decision
    from ..merge.merged_schema import MergedDocument, MergeEntry
    from ..merge.paper.method import PaperSettings
    from ..merge.robust.explained import Merge
    from ..merge.robust.settings import RobustSettings
    from ..topology.topomap import TopoMap


TO_MERGE = "topobatch merge --all"
"""What gives runs a verdict."""


@grouped
def explain(
    a: Annotated[
        str,
        typer.Argument(metavar="A", help="A run, or both as A:B.", autocompletion=complete_run),
    ],
    b: Annotated[
        str | None, typer.Argument(metavar="B", help="Another run.", autocompletion=complete_run)
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    method: Annotated[
        Literal["robust", "paper"],
        typer.Option(
            help="robust: the verdict, its evidence and threshold; "
            "paper: the tables and clusters of Huang & Beevers."
        ),
    ] = "robust",
    merge: MergeOption = MERGED,
    paper: PaperOptions = PaperOptions(),  # noqa: B008 - frozen
    as_json: JsonOption = False,
    rows: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Links, or rows of a table and clusters, to print at most. Default: what fits a "
            "screen; 20 of the paper's.",
        ),
    ] = None,
) -> None:
    """Explain why two runs were merged, or not.

    The verdict; the placement with the matched junctions; the evidence for and against it, link by
    link, in bits; the threshold and what it is made of; the next best placement and its distance.
    With --method paper the figures of Huang & Beevers instead: the table of vertex pairs with the
    hypotheses they belong to (Fig. 1), the clusters in transform space (Fig. 2). The same as a
    recording: explain/A+B.rrd, which topobatch view A:B opens, or of the paper's method
    explain/A+B.paper.rrd, for rerun.

    Runs that were not merged yet are explained as a merge of all runs would decide on them; of more
    than 100 runs by their two maps alone. A note says so.

    The paper's method takes the settings of merged.json, or of the merge that --merge names, if
    that is a merge by it, else the defaults; its options given here take the place of those.

    \b
      topobatch explain run1 run2
      topobatch explain run1 run2 --method paper --rows 5
    """
    place = Workspace(workspace, merge)
    if merge != MERGED:
        place.require_merge()
    a, b = (a, b) if b is not None else _both(place, a)
    if a == b:
        raise UsageError(f"two runs are needed, got {a!r} twice")
    first, second = place.chosen_runs([a, b], False)
    if method == "paper":
        _by_paper(place, (first, second), paper, as_json, rows)
    else:
        paper.refuse()
        _by_evidence(place, (first, second), as_json, rows)


def _both(place: Workspace, named: str) -> tuple[str, str]:
    """The runs of "A:B"."""
    if pair := pair_named(named, place.runs()):
        return pair
    if ":" in named:
        raise place.unknown([named], "runs A:B named")
    raise UsageError("two runs are needed: topobatch explain A B")


def _by_evidence(place: Workspace, pair: tuple[str, str], as_json: bool, rows: int | None) -> None:
    """Explain the decision of the robust method."""
    from dataclasses import replace

    from ..merge.decision import to_document
    from ..merge.decision_text import lines
    from ..viz.decision_recording import write_decision_recording

    a, b, decision = decided(place, pair)
    if as_json:
        say_lines(json.dumps(to_document(decision)))
    else:
        here = replace(decision, notes=tuple(_here(place, note) for note in decision.notes))
        for line in lines(here, rows, width()):
            say_lines(line)
    recording = place.explain_rrd(*pair)
    _record(
        recording,
        lambda: write_decision_recording(recording, a, b, decision),
        as_json,
        f"  (look at it: {place.call('view', ':'.join(pair))})",
    )


def _here(place: Workspace, note: str) -> str:
    """A note with the call that it suggests on this workspace. Pictures and recordings, which may
    be moved, have it without."""
    return note.replace(f"({TO_MERGE})", f"({place.call('merge', '--all')})")


def decided(place: Workspace, pair: tuple[str, str]) -> tuple[TopoMap, TopoMap, Decision]:
    """The maps of a pair and the decision on it, with the settings and runs of the merge that had
    both. Without such a merge the decision is the one that a merge would come to, or, of very many
    maps, that of the two by themselves."""
    from dataclasses import replace

    from ..merge.robust.explained import Merge, explain
    from .unchanged import changed_since, told_changed

    document = _last_merge(place)
    why_not = _not_merged(document, pair, place.merged_json.name)
    settings, read = settings_of(place, document), cache(place.read_map)
    if document is None or why_not:
        own = ""
        if document is not None:
            what = "at the rate" if document.graph.method == "paper" else "with the settings"
            own = f", {what} of {place.merged_json.name}"
        held = document is not None and _holds(document, pair)
        runs = sorted(document.graph.home) if document is not None and held else place.runs()
        merge, notes = _before_a_merge(place, runs, read, settings, pair, own)
        notes[0] = f"{why_not}; {notes[0]}"
    else:
        result, kept = place.read_result(), kept_results(place, settings, warn)
        merge = Merge.of(result, read, settings, place.locks(), kept)
        new = changed_since(place, document.graph.maps or {}, pair)
        notes = [f"{told_changed(new)}; merge again"] if new else []
    decision = explain(merge, *pair)
    told = replace(decision, notes=(*notes, *decision.notes))
    a, b = map(read, pair)
    return a, b, replace(told, of_merge=told.of_merge and not why_not)


def _before_a_merge(
    place: Workspace,
    runs: Sequence[str],
    read: Callable[[str], TopoMap],
    settings: RobustSettings,
    pair: tuple[str, str],
    own: str,
) -> tuple[Merge, list[str]]:
    """Maps that were not merged, as a merge, and notes on what is told of a pair. own: whose the
    settings are."""
    from ..merge.merging import MOST_LISTED, MergeSettings, merge_maps
    from ..merge.result import pairs_of
    from ..merge.robust import Means
    from ..merge.robust.explained import Merge

    locks, gone = place.locks(), place.discards()
    if pairs_of(len(runs)) <= MOST_LISTED:
        maps, lost = _readable(runs, read, pair)
        means = Means(kept=kept_results(place, settings, warn))
        result = merge_maps(
            maps, MergeSettings(robust=settings), locks=locks, discarded=gone, means=means
        )
        notes = [f"this is what a merge of {counted(len(maps), 'map')} would say{own}"]
        if lost:
            what = f"the map{'' if len(lost) == 1 else 's'} of {listed(lost, 3)}"
            notes.append(f"{what} cannot be read: the merge is told without")
        return Merge.of(result, read, settings, locks, means.kept), notes
    notes = [
        f"this is what the two maps say by themselves, asked as one pair of "
        f"{counted(len(runs), 'map')}{own}; a merge also counts what the others say"
    ]
    told = {"same": "locked as the same", "never": "locked apart"}
    notes += [f"{told[k.decision]}, which is not counted here" for k in locks if (k.a, k.b) == pair]
    if pair in gone:
        notes.append("the match was discarded, which is not counted here")
    return Merge(read, len(runs), {}, settings, locks), notes


def _readable(
    runs: Sequence[str], read: Callable[[str], TopoMap], pair: tuple[str, str]
) -> tuple[list[TopoMap], list[str]]:
    """The maps of these runs, and the names of those that cannot be read; a pair has to be."""
    maps, lost = [], []
    for run in runs:
        try:
            maps.append(read(run))
        except (DocumentError, FileNotFoundError):
            if run in pair:
                raise
            lost.append(run)
    return maps, lost


def settings_of(place: Workspace, document: MergedDocument | None) -> RobustSettings:
    """The settings of the selected merge; of one by the paper's method its rate."""
    from ..merge.robust.settings import DEFAULT_ROBUST, settings_from_document

    if document is None:
        return DEFAULT_ROBUST
    values = document.graph.settings or {}
    if document.graph.method == "paper":
        values = {k: v for k, v in values.items() if k == "false_merge_rate"}
    try:
        return settings_from_document(values)
    except ValueError as error:
        raise DocumentError(f"{place.merged_json}: graph.settings: {error}") from error


def _last_merge(place: Workspace) -> MergedDocument | None:
    """The document of the selected merge, if there is one."""
    return place.read_merged() if place.merged_json.exists() else None


def _not_merged(document: MergedDocument | None, pair: tuple[str, str], name: str) -> str:
    """Why the workspace's merge has no verdict on a pair, "" if it has one."""
    if document is None:
        return f"not merged yet ({TO_MERGE})"
    if document.graph.method == "paper":
        return f"{name} is a merge by --method paper (see topobatch explain --method paper)"
    return "" if _holds(document, pair) else f"{name} does not hold both runs"


def _holds(document: MergedDocument, pair: tuple[str, str]) -> bool:
    """Whether both runs are in a merge."""
    return document.graph.home.keys() >= set(pair)


def _record(recording: Path, draw: Callable[[], None], quiet: bool, how: str = "") -> None:
    """Write a recording; a failure to write is only a warning. how: to look at it."""
    try:
        draw()
    except OSError as error:
        warn(f"{recording}: not written: {error.strerror or error}")
        return
    if not quiet:
        say(f"recording: {recording}{how}")


def _by_paper(
    place: Workspace,
    pair: tuple[str, str],
    options: PaperOptions,
    as_json: bool,
    rows: int | None,
) -> None:
    """Show the result of the paper's method."""
    from ..merge.paper.explain import explain as explained
    from ..merge.paper.explain import lines, to_document
    from ..merge.paper.method import DEFAULT_PAPER
    from ..viz.explain_recording import write_explain_recording

    map_a, map_b = (place.read_map(run) for run in pair)
    document = _last_merge(place)
    merged_with = _merged_with(place, document)
    found = explained(map_a, map_b, options.over(merged_with or DEFAULT_PAPER))
    said = None if document is None else document.entry(*pair)
    name = place.merged_json.name
    if as_json:
        say_lines(json.dumps(to_document(found) | {"verdict": said and said.model_dump()}))
    else:
        how = "" if found.settings == merged_with else ", with the settings of that merge"
        how = " by another method" if merged_with is None else how
        verdict = [f"verdict: not merged yet; {place.call('merge', '--all')}"]
        if said is not None:
            verdict = _verdict_lines(said, f"{name}{how}")
        elif document is not None:
            verdict = [f"verdict: {name} does not list the two runs as a pair"]
        for line in [*lines(found, rows or 20), "", *verdict]:
            say_lines(line)
    recording = place.explain_rrd(*pair, method="paper")
    how = f"  (look at it: {shlex.join(('rerun', str(recording)))})"
    _record(
        recording, lambda: write_explain_recording(recording, map_a, map_b, found), as_json, how
    )


def _merged_with(place: Workspace, document: MergedDocument | None) -> PaperSettings | None:
    """The settings of the last merge by the paper's method; None if it was another one."""
    from ..merge.paper.method import settings_from_document

    if document is None or document.graph.method != "paper":
        return None
    try:
        return settings_from_document(document.graph.settings or {})
    except ValueError as error:
        raise DocumentError(f"{place.merged_json}: graph.settings: {error}") from error


def _verdict_lines(said: MergeEntry, merge: str) -> list[str]:
    """The verdict of a merge, of any method. merge: name of its document."""
    from math import degrees

    from ..merge.result import shown_bits

    bits = shown_bits(said.evidence_bits)
    lines = [f"verdict of {merge}: {said.verdict}, {bits} bits: {said.reason}"]
    lines += [f"  against it: {sentence}" for sentence in said.contradictions]
    if said.runner_up is not None:
        at = said.runner_up.transform
        lines.append(
            f"  next best: {shown_bits(said.runner_up.evidence_bits)} bits, "
            f"{counted(len(said.runner_up.matched), 'junction')}, at ({at.x:.2f}, {at.y:.2f}) m, "
            f"turned by {degrees(at.theta):.1f}°"
        )
    if said.advice:
        lines.append(f"  to settle it: {said.advice}")
    return lines
