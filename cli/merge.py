"""`topobatch merge`: maps of many runs to one document that says what belongs together."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..merge.decision_text import weakest_links
from ..merge.result import MergeResult, PairVerdict, Standing, home_of
from ..merge.wording import describe_bits
from ..topology.errors import DataError, DocumentError, UsageError
from ..topology.wording import counted, listed
from ..viz.pages import describe_pairs
from .journal import note
from .matching import MatchOptions, match_share, read_maps, resumable
from .merges import last_merge, made
from .options import (
    RUNS,
    FalseMergeRate,
    Here,
    JsonOption,
    QuietOption,
    VerboseOption,
    by_settings,
    verb,
)
from .output import is_verbose, say, say_folded, say_json, show, warn
from .paper_options import PaperOptions
from .workspace import MERGED, Workspace

if TYPE_CHECKING:  # what takes a second to load
    from ..merge.merging import MergeSettings

MOST_SHOWN = 8
"""Ambiguous pairs, sites, and runs of a site that are printed: the end of a merge fits on a screen
of 24 lines; `list`, `explain` and --verbose tell more."""

OVERWRITE = "give this merge another --output NAME, or overwrite with --replace"


@dataclass(frozen=True, slots=True)
class MethodOptions:
    """How runs are merged."""

    method: Annotated[
        Literal["robust", "paper"],
        "--method",
        "robust: tolerant matching, evidence in bits, three verdicts; paper: Huang & Beevers, "
        "section by section, for comparison.",
    ] = "robust"
    false_merge_rate: FalseMergeRate = None

    def settings(self, paper: PaperOptions) -> MergeSettings:
        """The settings; UsageError if they are invalid."""
        from ..merge.merging import MergeSettings

        settings = MergeSettings(method=self.method)
        of_paper, robust = paper.over(settings.paper), settings.robust
        if self.false_merge_rate is not None:
            of_paper = replace(of_paper, false_merge_rate=self.false_merge_rate)
            robust = replace(robust, false_merge_rate=self.false_merge_rate)
        return replace(settings, paper=of_paper, robust=robust)


@verb
def merge(
    context: typer.Context,
    runs: Annotated[list[str] | None, "RUN", "Runs to merge, by name.", RUNS] = None,
    everything: Annotated[bool, "--all", "Merge every run of the workspace."] = False,
    *,
    place: Here,
    how: MethodOptions,
    output: Annotated[
        str | None,
        "--output NAME",
        "Write NAME.json and NAME.rrd instead of merged.json and merged.rrd.",
    ] = None,
    replace_last: Annotated[
        bool, "--replace", "Overwrite a merge of runs that this one leaves out."
    ] = False,
    paper: PaperOptions,
    where: MatchOptions,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Merge the maps of many runs, where they overlap.

    Writes merged.json and merged.rrd in the workspace. A merge that is there is overwritten by one
    with all of its runs; one that leaves out any, whose map is missing or damaged for instance, is
    refused without --replace. (topobatch discard RUN takes a run out of the merges.)

    Every pair of runs gets a verdict: merged (the same place, and the evidence says so), ambiguous
    (an alignment fits, but the evidence falls short, or another fits nearly as well) or unrelated.
    Only merged pairs join; --verbose lists them. The order of the runs does not matter.

    \b
      topobatch merge --all
      topobatch merge run1 run2 --output two
    """
    show(quiet=quiet or as_json, verbose=verbose)
    if output is not None:
        place = Workspace(place.root, output)
        place.check_merge()
    if how.method == "robust":
        paper.refuse()
    if where.shard is not None:
        if not everything or runs or how.method != "robust" or as_json:
            raise UsageError("--shard goes with --all and the robust method, and without --json")
        if output is not None:
            raise UsageError(
                "--shard fills the cache, from which any merge is made; "
                "--output goes with the last merge --all"
            )
        with resumable():
            match_share(place, how.settings(paper).robust, where)
        return
    with resumable(), place.held():
        chosen = place.chosen_runs(runs or [], everything)
        last = None if replace_last else _merged_before(place, chosen, everything)
        maps, broken = read_maps(place, chosen)
        before = {} if last is None else last.home
        if lost := before.keys() & set(broken):
            raise DataError(_leaves_out(place, before, lost, ", without a readable map"))
        last = last or last_merge(place)
        result, moved = made(place, maps, how.settings(paper), last, where)
        runs_of = counted(sum(len(c.poses) for c in result.components), "run")
        summary = "; ".join([f"{place.merge}: {runs_of}, {describe_pairs(result)}", *moved])
        note(place, "merge", f"{summary}{by_settings(context, place)}")
    _show(result, place)
    for each in moved:
        say_folded(each)
    if as_json:
        say_json(_document(place, result))
    if broken:
        raise typer.Exit(1)


def _merged_before(place: Workspace, chosen: list[str], everything: bool) -> MergeResult | None:
    """The merge that will be overwritten, if any.

    UsageError if it has others than the chosen ones, or if no merge is there but something else;
    that a merge of everything overwrites, except under a name of its own.
    """
    path = place.merged_json
    if not path.exists():
        return None
    try:
        last = place.read_result()
    except DocumentError as error:
        if not everything or place.merge != MERGED:
            raise UsageError(f"{error}; {OVERWRITE}") from error
        warn(f"{error}; it is overwritten")
        return None
    before = last.home
    # Pieces (RUN#2) go where the log of their run, ingested again, gives them no more.
    if lost := {run for run in before if not {run, run.partition("#")[0]} & {*chosen}}:
        why = ", without a map (their logs, ingested again, make them)" if everything else ""
        raise UsageError(_leaves_out(place, before, lost, why))
    return last


def _leaves_out(place: Workspace, before: Collection[str], lost: set[str], why: str) -> str:
    """That a merge with the runs `before` is not overwritten by one without `lost`."""
    return (
        f"{place.merged_json}: is the merge of {counted(len(before), 'run')}, and this one leaves "
        f"out {listed(sorted(lost))}{why}; {OVERWRITE}"
    )


def _show(result: MergeResult, place: Workspace) -> None:
    """Print the summary of a merge: the pairs first, and the answer last, where it stays on the
    screen."""
    for text in _warnings(result):
        warn(text)
    _show_pairs(result)
    say(f"{place.merged_json}")
    say_folded(describe_pairs(result))
    _show_sites(result, place)
    name = () if place.merge == MERGED else (place.merge,)
    say(f"{place.merged_rrd}  (look at it: {place.call('view', *name)})")
    for text in _next_steps(result, place):
        say(text)


def _show_pairs(result: MergeResult) -> None:
    """Print the ambiguous pairs of runs, strongest first, with advice on the first of them; with
    --verbose all of them, and those that are merged."""
    from ..merge.merging import ALONE

    pairs: dict[Standing, list[PairVerdict]] = {}
    for pair in result.verdicts:
        pairs.setdefault(pair.standing, []).append(pair)
    if is_verbose():
        for pair in pairs.get(Standing.MERGED, ()):
            say_folded(f"  {pair.a} + {pair.b}: {pair.reason}")
        for pair in pairs.get(Standing.JOINED, ()):
            say_folded(f"  {pair.a} … {pair.b}: {pair.reason.partition(ALONE)[0]}")
    ambiguous = sorted(pairs.get(Standing.AMBIGUOUS, ()), key=lambda pair: -pair.evidence_bits)
    for pair in ambiguous if is_verbose() else ambiguous[:MOST_SHOWN]:
        say_folded(f"  {pair.a} ? {pair.b}: ambiguous: {_open_because(pair)}")
    if len(ambiguous) > MOST_SHOWN and not is_verbose():
        say(f"  and {len(ambiguous) - MOST_SHOWN} more ambiguous: --verbose lists them")
    advice = next((pair for pair in ambiguous[:MOST_SHOWN] if pair.advice), None)
    if advice is not None:
        say_folded(f"  to settle {advice.a} ? {advice.b}: {advice.advice}")


def _open_because(pair: PairVerdict) -> str:
    """Why an ambiguous pair is not merged, in brief if its own evidence is what falls short."""
    if not pair.lacks or pair.locked or pair.threshold_bits is None:
        return pair.reason
    return f"{describe_bits(pair.evidence_bits, pair.threshold_bits)}; {pair.lacks}"


def _show_sites(result: MergeResult, place: Workspace) -> None:
    """Print a line for each site, the largest first, and one for runs that stand alone."""
    sites = sorted((c for c in result.components if c.is_site), key=lambda c: -len(c.poses))
    home = home_of(sites[:MOST_SHOWN])
    weakest = weakest_links(result.verdicts, home)
    for site in sites[:MOST_SHOWN]:
        names = listed(sorted(site.poses), MOST_SHOWN)
        runs = counted(len(site.poses), "run")
        say_folded(f"site {site.name}: {runs}: {names}{weakest.get(site.id, '')}")
    if len(sites) > MOST_SHOWN:
        more = counted(len(sites) - MOST_SHOWN, "more site")
        say(f"and {more}: {place.call('list')}")
    alone = [run for c in result.components if not c.is_site for run in c.poses]
    if alone:
        say_folded(f"alone: {listed(sorted(alone), MOST_SHOWN)}")


def _next_steps(result: MergeResult, place: Workspace) -> Iterator[str]:
    """What to do next: name a site that has the name of a run only; record what joins more; read
    the report; export."""
    given = place.sites()
    for site in result.components:
        run = site.name.removeprefix("site-")
        if site.name not in {run, *given} and run in site.poses:
            yield f"name a site: {place.call('site', run, 'NAME')}"
            break
    if open_ := result.standings()[Standing.AMBIGUOUS]:
        pairs, call = counted(open_, "pair is", "pairs are"), place.call("next", *place.of_merge)
        yield f"{pairs} open; what to record to settle most: {call}"
    if place.merge == MERGED:
        yield f"all on one page: {place.call('report')}"
        yield f"route graphs: {place.call('export', '--format', 'nav2')}"


def _document(place: Workspace, result: MergeResult) -> dict[str, Any]:
    """The merge as JSON values: its files, its sites, the number of pairs by standing."""
    return {
        "merged": str(place.merged_json),
        "recording": str(place.merged_rrd),
        "sites": [
            {"site": c.name, "component": c.id, "runs": sorted(c.poses)} for c in result.components
        ],
        "pairs": {str(standing): count for standing, count in result.standings().items()},
        "warnings": [*_warnings(result)],
    }


def _warnings(result: MergeResult) -> Iterator[str]:
    from ..merge.robust.entries import doubt

    home = result.home
    yield from map(str, result.info.get("warnings") or ())
    for pair in result.verdicts:
        if pair.locked == "same" and home[pair.a] != home[pair.b]:
            yield f"{pair.a} and {pair.b} are not joined: {pair.reason}"
        if pair.accepted_by == "lock" and (why := doubt(pair)):
            yield f"{pair.a} and {pair.b} are joined by a lock; by their maps {why}"
