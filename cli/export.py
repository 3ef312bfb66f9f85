"""`topobatch export`: maps in the formats of others."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..topology.errors import DataError, DocumentError, UsageError
from ..topology.wording import counted, listed, utc
from .options import DEFAULT_WORKSPACE, QuietOption, WorkspaceOption, complete_map
from .output import Screen, checked_output, say_text
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from ..ingest.remote.path import LogPath
    from ..merge.merged_schema import MergedDocument
    from ..topology.odometry import Odometry
    from ..topology.run import Run
    from ..topology.topomap import TopoMap

STDOUT = Path("-")

CLOCKS_APART_NS = 10**9
"""How far passes may lie before or after all odometry."""

MOST_NAMED = 4
"""Components, and runs of each, that a warning lists."""


Format = Literal["nav2", "lif", "rmf", "tmap2", "graphml", "g2o", "tum", "csv"]


def export(
    what: Annotated[
        str,
        typer.Argument(
            metavar="RUN|merged",
            help="A run, or the merged map (merged, or the --output NAME of a merge).",
            autocompletion=complete_map,
        ),
    ],
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            "-f",
            help="nav2: GeoJSON of the Nav2 route server; lif: VDMA LIF 1.0; rmf: Open-RMF "
            "navigation graph; tmap2: LCAS topological map; graphml; g2o: pose graph; "
            "tum: trajectories; csv: two tables.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="File to write, - for the standard output; default: in the workspace's exports/.",
        ),
    ] = None,
    component: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=0, help="Only this component of the merged map; default: a file each."
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            metavar="METRES",
            min=0.001,
            max=10.0,
            help="How far a corridor may lie from its straight pieces (nav2, lif, rmf, tmap2).",
        ),
    ] = 0.05,
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG",
            help="Where the log of the run is now, for tum; default: where ingest read it.",
        ),
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    quiet: QuietOption = False,
) -> None:
    """Write a map in a format that others load.

    The merged map has components that share no frame: each becomes a file of its own, numbered like
    the components of topobatch merge; files of components that are no more go from exports/.
    Trajectories (tum) are read from the run's log again.

    \b
      topobatch export merged --format nav2 --output site.geojson
      topobatch export run1 --format tum
    """
    place, screen = Workspace(workspace), Screen(quiet)
    if output not in (None, STDOUT):
        checked_output(output)
    sources = _sources(place, what, component, screen)
    texts: dict[str, str] = {}
    for source in sources:
        for ending, text in _texts(place, source, form, tolerance, log, screen).items():
            texts[f"{source.name}{ending}"] = text
    if not texts:
        raise DataError(f"{what}: nobody drove its maps, which are of grids: no trajectories")
    if output == STDOUT:
        _to_stdout(texts, sources)
        return
    paths = _paths(place, output, texts, sources)
    for path, text in paths.items():
        _write(path, text)
        screen.line(str(path))
    if output is None and component is None and sources[0].document is not None:
        for path in _superseded(place, what, form, paths):
            path.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """A map to export: a run's, or a component's with its document."""

    name: str
    topomap: TopoMap
    maps: dict[str, TopoMap]
    document: MergedDocument | None = None
    component: int = 0


def _sources(place: Workspace, what: str, component: int | None, screen: Screen) -> list[_Source]:
    """The maps to export: a run's, or one for each component of a merge."""
    merged = _merge_named(place, what)
    if merged is None:
        if component is not None:
            raise UsageError(f"--component goes with the merged map; {what!r} is a run")
        (run,) = place.chosen_runs([what], False)
        topomap = place.read_map(run)
        return [_Source(run, topomap, {run: topomap})]
    document = merged.read_merged()
    ids = [c.id for c in document.graph.components]
    if component is not None and component not in ids:
        raise merged.no_component(component, ids)
    chosen = ids if component is None else [component]
    several = len(ids) > 1
    if several and component is None:
        held = (
            f"{c.id}: {listed(sorted(c.runs), MOST_NAMED)}"
            for c in document.graph.components[:MOST_NAMED]
        )
        more = f"; and {len(ids) - MOST_NAMED} more" if len(ids) > MOST_NAMED else ""
        screen.warn(
            f"{counted(len(ids), 'component')} that share no frame: a file each "
            f"({'; '.join(held)}{more}); choose one by --component"
        )
    stem = merged.merge
    return [
        _component(merged, document, c, f"{stem}-{c}" if several else stem, screen) for c in chosen
    ]


def _merge_named(place: Workspace, what: str) -> Workspace | None:
    """The workspace with the merge of this name; None if it is a run's."""
    if what == MERGED:
        return place
    return None if what in place.runs() else place.merge_named(what)


def _component(
    place: Workspace, document: MergedDocument, component: int, name: str, screen: Screen
) -> _Source:
    from ..merge.component_map import component_map, stale_runs

    maps = {}
    for run in document.graph.runs_of(component):
        try:
            maps[run] = place.read_map(run)
        except DocumentError as error:
            screen.warn(f"{error}; exported without it")
    stale = stale_runs(document, component, maps)
    if stale:
        told = ", ".join(f"{run} {why}" for run, why in list(stale.items())[:3])
        screen.warn(
            f"component {component}: times are left out: not all maps are those that were merged "
            f"({told}); merge again"
        )
    try:
        topomap = component_map(document, component, name, maps)
    except ValueError as error:
        raise DocumentError(f"{place.merged_json}: component {component}: {error}") from error
    kept = {run: m for run, m in maps.items() if run not in stale}
    return _Source(name, topomap, kept, document, component)


def _texts(
    place: Workspace,
    source: _Source,
    form: Format,
    tolerance: float,
    log: Path | None,
    screen: Screen,
) -> dict[str, str]:
    """The texts to write by the suffix of their files."""
    from ..topology.turning_vertices import with_turning_points
    from ..viz.exports import MAP_FORMATS

    if form == "tum":
        return _trajectories(place, source, log, screen)
    if log is not None:
        raise UsageError("--log goes with --format tum")
    if form == "g2o":
        return {".g2o": _pose_graph(source)}
    whole = with_turning_points(source.topomap)
    return {ending: text_of(whole, tolerance) for ending, text_of in MAP_FORMATS[form].items()}


def _pose_graph(source: _Source) -> str:
    from ..merge.component_map import component_pose_graph
    from ..topology.map_pose_graph import map_pose_graph
    from ..viz.exports import pose_graph_g2o

    if source.document is None:
        return pose_graph_g2o(map_pose_graph(source.topomap))
    runs = source.document.graph.runs_of(source.component)
    gone = [run for run in runs if run not in source.maps]
    if gone:
        raise DataError(
            f"{source.name}: the joint pose graph needs the maps that were merged; "
            f"{listed(gone, 3)} {'is' if len(gone) == 1 else 'are'} not among them: merge again"
        )
    return pose_graph_g2o(component_pose_graph(source.document, source.component, source.maps))


def _trajectories(
    place: Workspace, source: _Source, log: Path | None, screen: Screen
) -> dict[str, str]:
    """The odometry of every run, as recorded and corrected, from its log; maps of grids have
    none."""
    from ..merge.document import poses_from_document
    from ..viz.exports import corrected_tum, recorded_tum

    if log is not None and len(source.maps) != 1:
        raise UsageError(f"--log goes with one run; {source.name} has {len(source.maps)}")
    poses = {} if source.document is None else poses_from_document(source.document)
    out = {}
    for run, topomap in sorted(source.maps.items()):
        if len(topomap.observation_time_ns) == 0:
            if source.document is not None:
                screen.warn(f"{run}: is the map of a grid, which nobody drove: no trajectory")
            continue
        odometry = _odometry(place, topomap, log)
        corrected = corrected_tum(topomap, odometry, poses.get(run))
        if corrected is None:
            raise DataError(
                f"run {run}: no junction pass of its map lies within the odometry of its log"
            )
        stem = "" if source.document is None else f".{run}"
        out[f"{stem}.recorded.tum"] = recorded_tum(odometry)
        out[f"{stem}.corrected.tum"] = corrected
    return out


def _odometry(place: Workspace, topomap: TopoMap, log: LogPath | None) -> Odometry:
    """A run's odometry from its log, with the recorded settings of its ingest, if any.

    UsageError if another log was named than the one that the map was made from, DataError if that
    one changed.
    """
    from ..ingest.reading import ReadSettings, read_run
    from .ingest_worker import READ_OPTIONS, origin

    run, record = topomap.run, place.ingested(topomap.run) or {}
    at = log or place.log_of(run, "name it by --log")
    told = record.get("read")
    how: dict[str, Any] = told if isinstance(told, dict) else {}
    known = {name: how[name] for name in READ_OPTIONS if isinstance(how.get(name), str)}
    found = read_run(at, ReadSettings(**known))
    why = _differs(topomap, found)
    if why is None:
        return found.odometry
    made_from = record.get("log")
    if log is None or made_from == origin(at):
        raise DataError(
            f"{at}: changed since the map of run {run} was made from it ({why}); ingest it again"
        )
    was = made_from if isinstance(made_from, str) else "it is not recorded which that was"
    raise UsageError(
        f"{at}: is not the log that the map of run {run} was made from ({was}): {why}; name that "
        "log, wherever it is now"
    )


def _differs(topomap: TopoMap, found: Run) -> str | None:
    """What shows that a map was not made from this log: the number of messages on a topic that both
    name, or times of passes before or after its odometry; None if nothing does."""
    source = topomap.info.get("source")
    stated: Mapping[str, Any] = source if isinstance(source, Mapping) else {}
    for what in ("odometry", "junctions"):
        here, there = found.source.get(what), stated.get(what)
        if not isinstance(here, Mapping) or not isinstance(there, Mapping):
            continue
        count, before = here.get("messages"), there.get("messages")
        if here.get("topic") == there.get("topic") and count != before:
            return f"{count} messages on {here.get('topic')}, where the map has {before}"
    passed, driven = topomap.observation_time_ns, found.odometry.time_ns
    if not len(passed) or not len(driven):
        return None
    begin, end = (int(driven[k]) for k in (0, -1))
    if passed.min() < begin - CLOCKS_APART_NS or passed.max() > end + CLOCKS_APART_NS:
        return f"driven {utc(begin)} to {utc(end)}, where the map begins {utc(int(passed.min()))}"
    return None


def _to_stdout(texts: dict[str, str], sources: list[_Source]) -> None:
    if len(texts) > 1:
        why = "choose one by --component" if len(sources) > 1 else "write them to files"
        raise UsageError(f"{len(texts)} files do not go to the standard output; {why}")
    for text in texts.values():
        say_text(text)


def _paths(
    place: Workspace, output: Path | None, texts: dict[str, str], sources: list[_Source]
) -> dict[Path, str]:
    """The file of each text. With an --output for several files, each file's own part comes before
    the suffix: out.csv becomes out.junctions.csv and out.corridors.csv."""
    if output is None:
        return {place.exports / name: text for name, text in texts.items()}
    if len(texts) == 1:
        return dict(zip([output], texts.values(), strict=True))
    # The names differ after their common prefix.
    shared = sources[0].name if len(sources) == 1 else sources[0].name.rpartition("-")[0]
    out = {}
    for name, text in texts.items():
        own = name.removeprefix(shared).removesuffix(output.suffix)
        out[output.with_name(f"{output.stem}{own}{output.suffix}")] = text
    return out


def _superseded(
    place: Workspace, merge: str, form: Format, written: Collection[Path]
) -> Iterator[Path]:
    """What the last export of a merge wrote and this one did not, as the components are others."""
    from ..viz.exports import ENDINGS

    endings = "|".join(map(re.escape, ENDINGS[form]))
    run = r"\..+" if form == "tum" else ""
    own = re.compile(rf"{re.escape(merge)}(-[0-9]+)?{run}({endings})")
    named = (*place.runs(), *(each.merge for each in place.merges()))
    others = tuple(f"{name}." for name in named if name != merge)
    for path in place.exports.iterdir():
        if own.fullmatch(path.name) and path not in written and not path.name.startswith(others):
            yield path


def _write(path: Path, text: str) -> None:
    from ..topology.files import write_text

    try:
        write_text(path, text)
    except PermissionError as error:
        raise DataError(f"{path}: {error.strerror}; name another --output") from error
