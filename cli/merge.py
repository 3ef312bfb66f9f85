"""`topobatch merge`: maps of many runs to one document that says what belongs together."""

from __future__ import annotations

import gc
import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..topology.errors import DataError, DocumentError, UsageError
from ..topology.wording import counted, listed
from .journal import note
from .matching import MatchOptions, kept_results, match_share, matching, read_maps, share_of
from .options import (
    DEFAULT_WORKSPACE,
    FalseMergeRate,
    JsonOption,
    QuietOption,
    VerboseOption,
    WorkspaceOption,
    complete_run,
    grouped,
)
from .output import Screen, say_lines
from .paper_options import PaperOptions
from .settings_file import by_settings
from .site_names import sites_before, with_sites
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from ..merge.merged_schema import MergedGraph
    from ..merge.merging import MergeSettings
    from ..merge.result import MergeResult, PairVerdict
    from ..merge.workers import Workers
    from ..topology.topomap import TopoMap

MOST_AMBIGUOUS, MOST_SITES, MOST_RUNS = 5, 12, 8
"""Limits of what is printed: ambiguous pairs, sites, runs of a site. The end of a merge fits on a
screen of 24 lines: what was found stays in sight, and `list`, `explain` and --verbose tell more."""

GARBAGE = 50_000
"""Threshold of new objects for the garbage collector. Maps and verdicts are hundreds of thousands
of long-lived objects; with the default of 700, collection takes a tenth of a merge of 200 maps, and
finds 2 MB."""

OVERWRITE = "give this merge another --output NAME, or overwrite with --replace"


@dataclass(frozen=True, slots=True)
class MethodOptions:
    """How runs are merged."""

    method: Annotated[
        Literal["robust", "paper"],
        typer.Option(
            help="robust: tolerant matching, evidence in bits, three verdicts; "
            "paper: Huang & Beevers, section by section, for comparison."
        ),
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


@grouped
def merge(
    runs: Annotated[
        list[str] | None,
        typer.Argument(metavar="RUN", help="Runs to merge, by name.", autocompletion=complete_run),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Merge every run of the workspace.")
    ] = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    how: MethodOptions = MethodOptions(),
    output: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Write NAME.json and NAME.rrd instead of merged.json and merged.rrd.",
        ),
    ] = None,
    replace_last: Annotated[
        bool,
        typer.Option("--replace", help="Overwrite a merge of runs that this one leaves out."),
    ] = False,
    paper: PaperOptions = PaperOptions(),  # noqa: B008 - frozen
    where: MatchOptions = MatchOptions(),  # noqa: B008 - frozen
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
    from ..viz.pages import pairs_told

    place, screen = Workspace(workspace), Screen(quiet or as_json, verbose)
    if output is not None:
        place = Workspace(workspace, output)
        place.check_merge()
    if how.method == "robust":
        paper.refuse()
    where.check()
    if where.shard is not None:
        if not everything or runs or how.method != "robust" or as_json:
            raise UsageError("--shard goes with --all and the robust method, and without --json")
        if output is not None:
            raise UsageError(
                "--shard fills the cache, from which any merge is made; "
                "--output goes with the last merge --all"
            )
        match_share(place, how.settings(paper), share_of(where.shard), where.workers, screen)
        return
    with place.held(screen.warn, make=False), _seldom_collected():
        chosen = place.chosen_runs(runs or [], everything)
        before = partial(_merged_before, place, chosen, everything, screen)
        result, moved, broken = _merged_or_standing(
            place, chosen, everything, (how, paper), dict if replace_last else before, where, screen
        )
        runs_of = counted(sum(len(c.poses) for c in result.components), "run")
        told = "; ".join([f"{place.merge}: {runs_of}, {pairs_told(result)}", *moved])
        note(place, "merge", f"{told}{by_settings(place)}", screen.warn)
    _show(result, place, screen)
    for each in moved:
        screen.folded(each)
    if as_json:
        say_lines(json.dumps(_told(place, result)))
    if broken:
        raise typer.Exit(1)


def _merged_or_standing(
    place: Workspace,
    chosen: list[str],
    everything: bool,
    asked: tuple[MethodOptions, PaperOptions],
    merged_before: Callable[[], dict[str, str]],
    where: MatchOptions,
    screen: Screen,
) -> tuple[MergeResult, list[str], list[str]]:
    """A merge that is made, or stands; what became of sites; and the runs whose maps cannot be
    read. merged_before: gives the runs that it may not leave out, with their sites."""
    from .unchanged import contents, made_from, remember, stands

    documents = contents(place, chosen)
    key = made_from(place, documents, asked)
    if stands(place, key):
        screen.detail("nothing is new: the merge of these maps lies there")
        return place.read_result(), [], []
    how, paper = asked
    settings, before = how.settings(paper), merged_before()
    maps, broken = read_maps(place, chosen, screen)
    if lost := before.keys() & set(broken):
        raise DataError(_leaves_out(place, before, lost, ", without a readable map"))
    result, moved = _merged(
        place, maps, settings, before or sites_before(place), where.workers, everything, screen
    )
    if not broken:
        remember(place, key, screen)
    return result, moved, broken


@contextmanager
def _seldom_collected() -> Iterator[None]:
    before = gc.get_threshold()
    gc.set_threshold(GARBAGE, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def merge_again(
    place: Workspace,
    affected: Collection[str],
    screen: Screen,
    new: Mapping[str, str] | None = None,
) -> None:
    """Repeat the merges that had one of the affected runs, each with the runs that still exist;
    new: new names of runs. The caller holds the workspace's lock."""
    for each in place.merges():
        _repeat(each, affected, screen, new or {})


def _repeat(
    place: Workspace, affected: Collection[str], screen: Screen, new: Mapping[str, str]
) -> None:
    """Repeat one merge; see `merge_again`."""
    from ..merge.document import read_merged
    from ..viz.pages import pairs_told

    try:
        graph = read_merged(place.merged_json).graph
        settings = _settings_of(graph)
    except (DocumentError, ValueError) as error:
        how = f"topobatch merge … --output {place.merge} --replace"
        how = place.call("merge", "--all") if place.merge == MERGED else how
        screen.warn(f"{error}; merge again: {how}")
        return
    if not graph.home.keys() & set(affected):
        return
    runs = sorted({new.get(run, run) for run in graph.home} & set(place.runs()))
    if not runs:
        place.merged_json.unlink()
        place.merged_rrd.unlink(missing_ok=True)
        screen.line(f"{place.merged_json}: removed; none of its runs is left")
        return
    maps, _ = read_maps(place, runs, screen)
    # A run alone is a site of its own name, old or new.
    before = {new.get(run, run): new.get(site, site) for run, site in graph.sites.items()}
    result, moved = _merged(
        place,
        maps,
        _about(settings, new, runs),
        before,
        MatchOptions().workers,
        runs == place.runs(),
        screen,
    )
    name = "" if place.merge == MERGED else f", {place.merge}"
    screen.line(f"merged again{name}: {counted(len(maps), 'run')}, {pairs_told(result)}")
    for each in moved:
        screen.line(each)


def _about(settings: MergeSettings, new: Mapping[str, str], runs: Collection[str]) -> MergeSettings:
    """Settings with the meetings of these runs alone; new: new names of runs."""
    met = (
        replace(m, run_a=new.get(m.run_a, m.run_a), run_b=new.get(m.run_b, m.run_b))
        for m in settings.paper.meetings
    )
    kept = tuple(m for m in met if {m.run_a, m.run_b} <= set(runs))
    return replace(settings, paper=replace(settings.paper, meetings=kept))


def _settings_of(graph: MergedGraph) -> MergeSettings:
    """The settings of a merge; ValueError if they are invalid."""
    from ..merge.document import settings_from_document
    from ..merge.merging import MergeSettings
    from ..merge.paper.method import PaperSettings
    from ..merge.robust import RobustSettings

    if graph.method == "paper":
        return MergeSettings(
            method="paper", paper=settings_from_document(PaperSettings, graph.settings)
        )
    return MergeSettings(robust=settings_from_document(RobustSettings, graph.settings))


def _merged_before(
    place: Workspace, chosen: list[str], everything: bool, screen: Screen
) -> dict[str, str]:
    """The runs of the merge that will be overwritten, with their sites ("" without a name).

    UsageError if it has others than the chosen ones, or if no merge is there but something else;
    that a merge of everything overwrites, except under a name of its own.
    """
    from ..merge.document import read_merged

    path = place.merged_json
    if not path.exists():
        return {}
    try:
        graph = read_merged(path).graph
        before = {run: graph.sites.get(run, "") for run in graph.home}
    except DocumentError as error:
        if not everything or place.merge != MERGED:
            raise UsageError(f"{error}; {OVERWRITE}") from error
        screen.warn(f"{error}; it is overwritten")
        return {}
    if lost := {run for run in before.keys() - set(chosen) if not _was_piece(place, run, chosen)}:
        why = ", without a map (their logs, ingested again, make them)" if everything else ""
        raise UsageError(_leaves_out(place, before, lost, why))
    return before


def _leaves_out(place: Workspace, before: Collection[str], lost: set[str], why: str) -> str:
    """That a merge with the runs `before` is not overwritten by one without `lost`."""
    return (
        f"{place.merged_json}: is the merge of {counted(len(before), 'run')}, and this one leaves "
        f"out {listed(sorted(lost))}{why}; {OVERWRITE}"
    )


def _was_piece(place: Workspace, run: str, chosen: Collection[str]) -> bool:
    """Whether a run was a piece (RUN#2) of a chosen one whose log, ingested again, gives it no
    more."""
    whole, mark, _ = run.rpartition("#")
    if not mark or whole not in chosen:
        return False
    gives = (place.ingested(whole) or {}).get("runs")
    return isinstance(gives, list) and run not in gives


def _merged(
    place: Workspace,
    maps: list[TopoMap],
    settings: MergeSettings,
    before: Mapping[str, str],
    workers: Callable[[int], Workers | None],
    everything: bool,
    screen: Screen,
) -> tuple[MergeResult, list[str]]:
    """Merge maps and write the files of the merge; and what became of the sites of the last one.
    before: the site of every run then."""
    from ..merge.merging import merge_maps
    from ..merge.result import pairs_of
    from .unchanged import contents

    # From these, later changes of maps are recognised.
    documents = contents(place, [m.run for m in maps])
    kept = kept_results(place, settings.robust, screen.warn)
    with matching(place, pairs_of(len(maps)), kept, workers, screen) as means:
        result = merge_maps(
            maps, settings, locks=place.locks(), discarded=place.discards(), means=means
        )
    if everything and settings.method == "robust":
        kept.settle()
    result, moved = with_sites(place, result, maps, before)
    result = replace(result, info={**result.info, "maps": documents})
    _write(place, result, maps, screen)
    return result, moved


def _write(place: Workspace, result: MergeResult, maps: Sequence[TopoMap], screen: Screen) -> None:
    """Write the document and the recording of a merge."""
    from ..merge.document import write_merged
    from ..topology.files import write_together
    from ..viz.merged_recording import write_merged_recording

    with screen.progress("writing", 0):
        write_together(
            {
                place.merged_json: partial(write_merged, result=result),
                place.merged_rrd: partial(write_merged_recording, result=result, maps=maps),
            }
        )


def rename_sites(place: Workspace, screen: Screen) -> None:
    """Call the sites of all merges as the workspace remembers them now. Nothing is matched, unless
    a merge cannot be read or its maps are others by now: that one is repeated. The caller holds the
    workspace's lock."""
    from .unchanged import changed_since

    for each in place.merges():
        try:
            result = each.read_result()
        except DocumentError:
            _repeat(each, place.runs(), screen, {})  # or say that it cannot be
            continue
        before = {run: c.site or "" for c in result.components for run in c.poses}
        known = result.info.get("maps") or {}
        if before.keys() - known.keys() or changed_since(place, known, [*before]):
            _repeat(each, before, screen, {})
            continue
        maps, _ = read_maps(each, sorted(before), screen)
        renamed, _ = with_sites(each, result, maps, before)
        if [c.name for c in renamed.components] != [c.name for c in result.components]:
            _write(each, renamed, maps, screen)


def _show(result: MergeResult, place: Workspace, screen: Screen) -> None:
    """Print the summary of a merge: the pairs first, and the answer last, where it stays on the
    screen."""
    from ..viz.pages import pairs_told

    for text in _warnings(result):
        screen.warn(text)
    _show_pairs(result, screen)
    screen.line(f"{place.merged_json}")
    screen.line(pairs_told(result))
    _show_sites(result, place, screen)
    name = () if place.merge == MERGED else (place.merge,)
    screen.line(f"{place.merged_rrd}  (look at it: {place.call('view', *name)})")
    for text in _next_steps(result, place):
        screen.line(text)


def _show_pairs(result: MergeResult, screen: Screen) -> None:
    """Print the ambiguous pairs of runs, strongest first, with advice on the first of them; with
    --verbose all of them, and those that are merged."""
    from ..merge.merging import ALONE
    from ..merge.result import Standing

    pairs: dict[Standing, list[PairVerdict]] = {}
    for pair in result.verdicts:
        pairs.setdefault(pair.standing, []).append(pair)
    if screen.verbose:
        for pair in pairs.get(Standing.MERGED, ()):
            screen.folded(f"  {pair.a} + {pair.b}: {pair.reason}")
        for pair in pairs.get(Standing.JOINED, ()):
            screen.folded(f"  {pair.a} … {pair.b}: {pair.reason.partition(ALONE)[0]}")
    ambiguous = sorted(pairs.get(Standing.AMBIGUOUS, ()), key=lambda pair: -pair.evidence_bits)
    for pair in ambiguous if screen.verbose else ambiguous[:MOST_AMBIGUOUS]:
        screen.folded(f"  {pair.a} ? {pair.b}: ambiguous: {_open_because(pair)}")
    advice = next((pair for pair in ambiguous[:MOST_AMBIGUOUS] if pair.advice), None)
    if advice is not None:
        screen.folded(f"  to settle {advice.a} ? {advice.b}: {advice.advice}")


def _open_because(pair: PairVerdict) -> str:
    """Why an ambiguous pair is not merged, in brief if its own evidence is what falls short."""
    from ..merge.wording import told_bits

    if not pair.lacks or pair.locked or pair.threshold_bits is None:
        return pair.reason
    return f"{told_bits(pair.evidence_bits, pair.threshold_bits)}; {pair.lacks}"


def _show_sites(result: MergeResult, place: Workspace, screen: Screen) -> None:
    """Print a line for each site of several runs, the largest first, and one for runs that stand
    alone."""
    sites = sorted((c for c in result.components if len(c.poses) > 1), key=lambda c: -len(c.poses))
    for site in sites[:MOST_SITES]:
        names = listed(sorted(site.poses), MOST_RUNS)
        sure = _weakest(result, site.poses)
        screen.folded(f"site {site.name}: {counted(len(site.poses), 'run')}: {names}{sure}")
    if len(sites) > MOST_SITES:
        more = counted(len(sites) - MOST_SITES, "more site")
        screen.line(f"and {more}: {place.call('list')}")
    alone = [run for c in result.components if len(c.poses) == 1 for run in c.poses]
    if alone:
        screen.folded(f"alone: {listed(sorted(alone), MOST_RUNS)}")


def _weakest(result: MergeResult, runs: Collection[str]) -> str:
    """The pair with the least evidence of those that hold the runs of a site together best."""
    from scipy.cluster.hierarchy import DisjointSet

    from ..merge.wording import told_bits

    told, joined = "", DisjointSet(runs)
    for pair in sorted(result.verdicts, key=lambda pair: -pair.evidence_bits):
        need = pair.threshold_bits
        if pair.accepted and pair.a in runs and need is not None and joined.merge(pair.a, pair.b):
            bits = told_bits(pair.evidence_bits, need)
            told = f"; weakest link {pair.a} + {pair.b}, {bits}"
    return told


def _next_steps(result: MergeResult, place: Workspace) -> Iterator[str]:
    """What to do next: give names to sites that have none but a run's; record what joins more."""
    from ..merge.result import Standing

    given = place.sites()
    for site in result.components:
        run = site.name.removeprefix("site-")
        if site.name not in given and site.name != run and run in site.poses:
            yield f"name a site: {place.call('site', run, 'NAME')}"
            break
    if open_ := result.standings()[Standing.AMBIGUOUS]:
        pairs = f"{counted(open_, 'pair')} {'is' if open_ == 1 else 'are'} open"
        yield f"{pairs}; what to record to settle most: {place.call('next', *place.of_merge)}"


def _told(place: Workspace, result: MergeResult) -> dict[str, Any]:
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

    home = {run: component.id for component in result.components for run in component.poses}
    yield from map(str, result.info.get("warnings") or ())
    for pair in result.verdicts:
        if pair.locked == "same" and home[pair.a] != home[pair.b]:
            yield f"{pair.a} and {pair.b} are not joined: {pair.reason}"
        if pair.accepted_by == "lock" and (why := doubt(pair)):
            yield f"{pair.a} and {pair.b} are joined by a lock; by their maps {why}"
