"""`topobatch merge`: maps of many runs to one document that says what belongs together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..topology.errors import DataError, DocumentError, UsageError
from . import paper_options
from .options import DEFAULT_WORKSPACE, QuietOption, WorkspaceOption
from .output import Screen, count, folded
from .workers import start_worker
from .workspace import MERGED, Workspace, shortened

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..merge.locks import Lock
    from ..merge.merging import MergeSettings
    from ..merge.result import MergeResult, PairVerdict
    from ..topology.topomap import TopoMap

MOST_LINES, MOST_JOINED = 20, 5


def merge(
    runs: Annotated[
        list[str] | None, typer.Argument(metavar="[RUN]...", help="Runs to merge, by name.")
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Merge every run of the workspace.")
    ] = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    method: Annotated[
        Literal["robust", "paper"],
        typer.Option(
            help="robust: tolerant matching, evidence in bits, three verdicts; "
            "paper: Huang & Beevers, section by section, for comparison."
        ),
    ] = "robust",
    false_merge_rate: Annotated[
        float | None,
        typer.Option(
            min=1e-9,
            max=0.5,
            help="Share of batches that may hold any false merge; default 0.001.",
        ),
    ] = None,
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
    degree: paper_options.DegreeOption = None,
    confidence: paper_options.ConfidenceOption = None,
    confidence_of: paper_options.ConfidenceOfOption = None,
    weights: paper_options.WeightsOption = None,
    iterative: paper_options.IterativeOption = None,
    met: paper_options.MetOption = None,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=0, help="Processes to match with; 0: one per core.")
    ] = 1,
    quiet: QuietOption = False,
) -> None:
    """Merge the maps of many runs, where they overlap.

    Writes merged.json and merged.rrd in the workspace; those of more runs are not overwritten
    unasked. Every pair of runs gets a verdict: merged
    (the same place, and the evidence says so), ambiguous (an alignment fits, but the evidence
    falls short, or another fits nearly as well) or unrelated. Only merged pairs join. The order of
    the runs does not matter.
    """
    place, screen = Workspace(workspace), Screen(quiet)
    if output is not None:
        place = Workspace(workspace, output)
        place.check_merge()
    options = paper_options.PaperOptions(
        degree, confidence, confidence_of, weights, iterative, tuple(met or ())
    )
    settings = _settings(method, false_merge_rate, options)
    with place.held(screen.warn, make=False):
        chosen = place.chosen_runs(runs or [], everything)
        # A merge of all loses nothing but runs that the workspace has lost.
        if not replace_last and (output is not None or not everything):
            _keep_larger(place, chosen)
        maps, broken = _read_maps(place, chosen, screen)
        result = _merged(maps, settings, place.locks(), jobs, screen)
        _write(place, result, maps)
    _summarise(result, place, screen)
    if broken:
        raise typer.Exit(1)


def _keep_larger(place: Workspace, chosen: list[str]) -> None:
    """UsageError where the result of a merge with other runs would be overwritten."""
    from ..merge.document import read_merged

    path = place.merged_json
    if not path.exists():
        return
    advice = "give this merge another --output NAME, or overwrite with --replace"
    try:
        before = {run for c in read_merged(path).graph.components for run in c.runs}
    except DocumentError as error:
        raise UsageError(f"{error}; {advice}") from error
    lost = sorted(before - set(chosen))
    if lost:
        raise UsageError(
            f"{path}: is the merge of {count(len(before), 'run')}, and this one leaves out "
            f"{shortened(lost)}; {advice}"
        )


def _read_maps(
    place: Workspace, names: list[str], screen: Screen
) -> tuple[list[TopoMap], list[str]]:
    """The maps that can be read, and the names of those that cannot."""
    maps, broken = [], []
    for name in names:
        try:
            maps.append(place.read_map(name))
        except DocumentError as error:
            screen.complain(f"{error}; left out (ingest its log again with --force)")
            broken.append(name)
    if not maps:
        raise DataError(f"{place.maps}: none of the {count(len(names), 'map')} can be read")
    return maps, broken


def _settings(
    method: Literal["robust", "paper"],
    false_merge_rate: float | None,
    options: paper_options.PaperOptions,
) -> MergeSettings:
    """The settings that the options ask for; UsageError if they are the other method's."""
    from ..merge.merging import MergeSettings

    if method == "robust":
        options.refuse()
    settings = MergeSettings(method=method)
    paper, robust = options.over(settings.paper), settings.robust
    if false_merge_rate is not None:
        paper = replace(paper, false_merge_rate=false_merge_rate)
        robust = replace(robust, false_merge_rate=false_merge_rate)
    return replace(settings, paper=paper, robust=robust)


def _merged(
    maps: list[TopoMap],
    settings: MergeSettings,
    locks: tuple[Lock, ...],
    jobs: int,
    screen: Screen,
) -> MergeResult:
    from ..merge.merging import merge_maps

    pairs = len(maps) * (len(maps) - 1) // 2
    with (
        _executor(jobs, pairs) as executor,
        screen.progress("matching", pairs, "pairs") as advance,
    ):
        return merge_maps(
            maps,
            settings,
            locks=locks,
            on_pair=lambda done, _: advance(done),
            executor=executor,
        )


@contextmanager
def _executor(jobs: int, pairs: int) -> Iterator[Executor | None]:
    """Processes to match in, where there is enough to do for them."""
    import multiprocessing
    import os
    from concurrent.futures import ProcessPoolExecutor

    workers = min(jobs or os.cpu_count() or 1, pairs)
    if workers < 2:
        yield None
        return
    with ProcessPoolExecutor(workers, initializer=start_worker) as pool:
        try:
            yield pool
        except BaseException:  # Ctrl-C: nobody waits for the pairs that are left
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _write(place: Workspace, result: MergeResult, maps: list[TopoMap]) -> None:
    from ..merge.document import write_merged
    from ..topology.document import write_together
    from ..viz import write_merged_recording

    write_together(
        {
            place.merged_json: partial(write_merged, result=result),
            place.merged_rrd: partial(write_merged_recording, result=result, maps=maps),
        }
    )


def _told(screen: Screen, text: str) -> None:
    """A line, folded; the rest of it is indented further."""
    for line in folded(text):
        screen.line(line)


def _summarise(result: MergeResult, place: Workspace, screen: Screen) -> None:
    from ..merge.merging import ALONE
    from ..merge.result import Standing

    def of(standing: Standing) -> list[PairVerdict]:
        return [pair for pair in result.verdicts if pair.standing is standing]

    home = {run: component.id for component in result.components for run in component.poses}
    for component in result.components:
        if len(component.poses) > 1:
            _told(screen, f"component {component.id}: {shortened(sorted(component.poses))}")
    alone = [run for c in result.components if len(c.poses) == 1 for run in c.poses]
    if alone:
        _told(screen, f"alone: {shortened(alone)}")
    for pair in result.verdicts:
        if pair.locked == "same" and home[pair.a] != home[pair.b]:
            screen.warn(f"{pair.a} and {pair.b} are not joined: {pair.reason}")
    merged, joined, ambiguous = map(of, (Standing.MERGED, Standing.JOINED, Standing.AMBIGUOUS))
    kept_out, unrelated = len(of(Standing.KEPT_OUT)), len(of(Standing.UNRELATED))
    for pair in merged[:MOST_LINES]:
        _told(screen, f"  {pair.a} + {pair.b}: {pair.reason}")
    if len(merged) > MOST_LINES:
        screen.line(f"  … and {len(merged) - MOST_LINES} more merged pairs, in {place.merged_json}")
    for pair in joined[:MOST_JOINED]:
        _told(screen, f"  {pair.a} … {pair.b}: {pair.reason.partition(ALONE)[0]}")
    if len(joined) > MOST_JOINED:
        screen.line(f"  … and {len(joined) - MOST_JOINED} more pairs joined through others")
    for pair in ambiguous[:MOST_LINES]:
        _told(screen, f"  {pair.a} ? {pair.b}: ambiguous: {pair.reason}")
        if pair.advice:
            _told(screen, f"    to settle it: {pair.advice}")
    if len(ambiguous) > MOST_LINES:
        screen.line(f"  … and {len(ambiguous) - MOST_LINES} more ambiguous pairs")
    screen.line(
        f"{count(len(result.verdicts), 'pair')}: {len(merged)} merged, "
        f"{f'{len(joined)} joined through others, ' if joined else ''}{len(ambiguous)} ambiguous, "
        f"{unrelated} unrelated{f', {kept_out} kept out' if kept_out else ''}; "
        f"{count(len(result.components), 'component')}"
    )
    screen.line(f"{place.merged_json}")
    name = "" if place.merge == MERGED else f" {place.merge}"
    screen.line(f"{place.merged_rrd}  (look at it: topobatch view{name})")
