"""`topobatch export`: maps in the formats of others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

from ..ingest.reading import read_run
from ..merge.changes import last_found
from ..merge.component_map import component_map, component_pose_graph, stale_runs
from ..merge.result import Component, MergeResult
from ..topology.errors import DataError, UsageError
from ..topology.map_pose_graph import map_pose_graph
from ..topology.topomap import TopoMap
from ..topology.wording import counted, listed
from ..viz.exports import map_texts
from ..viz.exports.pose_graph import pose_graph_g2o
from ..viz.exports.tum import corrected_tum, recorded_tum
from .export_grid import PICTURE, Exported, grid_of_saved, grid_texts, log_of
from .options import RUNS, ComponentOption, Extra, Here, JsonOption, QuietOption, SiteOption, verb
from .output import checked_output, say, say_json, say_text, show, warn, write_files
from .workspace import MERGED, Named, Workspace

STDOUT = Path("-")

Format = StrEnum("Format", "nav2 lif rmf tmap2 graphml grid g2o tum csv")


@verb
def export(
    forms: Annotated[
        list[Format],
        "--format -f",
        "nav2: GeoJSON of the Nav2 route server; lif: VDMA LIF 1.0; rmf: Open-RMF navigation "
        "graph; tmap2: LCAS topological map; graphml; grid: map.yaml and picture of map_server and "
        "AMCL; g2o: pose graph; tum: trajectories; csv: two tables.",
    ],
    what: Annotated[
        str,
        "[RUN|SITE|merged]",
        "A run, a site, or all sites of the merged map (merged, which is the default, or the "
        "--output NAME of a merge).",
        RUNS,
        Extra(show_default=False),
    ] = MERGED,
    output: Annotated[
        Path | None,
        "--output -o FILE",
        "File to write, - for the standard output; default: in the workspace's exports/.",
    ] = None,
    site: SiteOption = None,
    component: ComponentOption = None,
    tolerance: Annotated[
        float,
        "--tolerance METRES",
        "How far a corridor may lie from its straight pieces (nav2, lif, rmf, tmap2).",
        Extra(min=0.001, max=10.0),
    ] = 0.05,
    log: Annotated[
        Path | None,
        "--log LOG",
        "Where the log of the run is now, for tum and grid; default: where ingest read it.",
    ] = None,
    *,
    place: Here,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write a map in a format that others load.

    Sites share no frame: each becomes a file of its own, called like the site (topobatch list).
    Trajectories (tum) and scans (grid) are read from the runs' logs again.

    \b
      topobatch export --format nav2
      topobatch site run1 north
      topobatch export --site north --format nav2 --output north.geojson
      topobatch export run1 --format tum
    """
    show(quiet=quiet or as_json)
    form, *more = forms
    if more:
        raise UsageError(f"a call writes one --format; {len(forms)} are given: {', '.join(forms)}")
    if output not in (None, STDOUT):
        checked_output(output)
    if as_json and output == STDOUT:
        raise UsageError("--json tells of files; with --output - the map itself is printed")
    found = place.named(what)
    sources = _sources(found, site, component)
    texts = _texts(place, sources, form, tolerance, log, partial(_path, place, output, sources))
    if not texts:
        why = "nobody drove its maps, which are of grids: no trajectories"
        raise DataError(f"{what}: {why if form == 'tum' else f'no site has what {form} needs'}")
    one = len(texts) == 1
    if output == STDOUT:
        if not one:
            why = "choose one by --site" if len(sources) > 1 else "write them to files"
            raise UsageError(f"{len(texts)} files do not go to the standard output; {why}")
        for text in texts.values():
            say_text(str(text))
        return
    paths = {_path(place, output, sources, name, alone=one): text for name, text in texts.items()}
    write_files(paths)
    for path in paths:
        say(str(path))
    if as_json:
        say_json({"format": form, "files": sorted(map(str, paths))})


def _sources(found: Named, site: str | None, component: int | None) -> list[Exported]:
    """The maps to export: a run's, or one for each chosen component of a merge."""
    place = found.place
    if found.pair is not None:
        raise UsageError("one map is exported, of a run or of a site; a pair has none of its own")
    if found.run is not None:
        if (site, component) != (None, None):
            raise UsageError(f"--site goes with the merged map; {found.run!r} is a run")
        topomap = place.read_map(found.run)
        return [Exported(found.run, topomap, {found.run: topomap})]
    result = place.read_result()
    one = place.component(result, site or found.site, component)
    stem = "" if place.merge == MERGED else f"{place.merge}-"
    return [
        _component(place, result, c, f"{stem}{c.site or f'{MERGED}-{c.id}'}")
        for c in result.components
        if one in (None, c.id)
    ]


def _component(place: Workspace, result: MergeResult, component: Component, name: str) -> Exported:
    maps, errors = place.read_maps(sorted(component.poses))
    for error in errors.values():
        warn(f"{error}; exported without it")
    stale = stale_runs(result, component.id, maps)
    if stale:
        why_stale = ", ".join(f"{run} {why}" for run, why in list(stale.items())[:3])
        warn(
            f"component {component.id}: times are left out: not all maps are those that were "
            f"merged ({why_stale}); merge again"
        )
    with place.document_at_fault():
        topomap = component_map(result, component.id, name, maps)
    kept = {run: m for run, m in maps.items() if run not in stale}
    return Exported(name, topomap, kept, (result, component))


def _texts(
    place: Workspace,
    sources: list[Exported],
    form: Format,
    tolerance: float,
    log: Path | None,
    path_of: Callable[[str], Path],
) -> dict[str, str | bytes]:
    """The contents to write by the names of their files; a site that cannot be exported so costs no
    other. path_of: gives the path of a name."""
    if log is not None and form not in ("tum", "grid"):
        raise UsageError("--log goes with --format tum or grid")
    texts: dict[str, str | bytes] = {}
    for source in sources:
        if log is not None and len(source.maps) != 1:
            raise UsageError(
                f"--log goes with one run; {source.name} has {len(source.maps)}: ingest their logs "
                "from where they are now, which keeps the maps"
            )
        try:
            files: Mapping[str, str | bytes]
            if form == "grid":
                picture = path_of(f"{source.name}{PICTURE}").name
                files = grid_texts(place, source, log, picture)
            elif form == "tum":
                files = _trajectories(place, source, log)
            elif form == "g2o":
                files = {".g2o": _pose_graph(source)}
            else:
                walls = grid_of_saved(place, source)
                files = map_texts(_told_what_is_gone(place, source), form, tolerance, walls)
        except DataError as error:
            if len(sources) == 1:
                raise
            warn(f"left out: {error}")
            continue
        texts |= {f"{source.name}{ending}": text for ending, text in files.items()}
    return texts


def _told_what_is_gone(place: Workspace, source: Exported) -> TopoMap:
    """The map of a site with the corridors that its latest runs did not find, of which a warning
    tells; of other maps, and of stale ones, the map as it is."""
    if source.merge is None:
        return source.topomap
    result, site = source.merge
    whole = site.poses.keys() == source.maps.keys()
    gone = last_found(result, site.id, source.maps) if whole else {}
    if not gone:
        return source.topomap
    marked = "are gone: marked" if len(gone) > 1 else "is gone: marked"
    draw = place.call("changes", site.name, *place.of_merge, "-o", "changes.svg")
    warn(f"{site.name}: {counted(len(gone), 'corridor')} {marked} so in the file; see {draw}")
    return replace(source.topomap, info={**source.topomap.info, "gone": gone})


def _pose_graph(source: Exported) -> str:
    if source.merge is None:
        return pose_graph_g2o(map_pose_graph(source.topomap))
    result, site = source.merge
    if gone := sorted(site.poses.keys() - source.maps.keys()):
        raise DataError(
            f"{source.name}: the joint pose graph needs the maps that were merged; "
            f"{listed(gone, 3)} {'is' if len(gone) == 1 else 'are'} not among them: merge again"
        )
    return pose_graph_g2o(component_pose_graph(result, site.id, source.maps))


def _trajectories(place: Workspace, source: Exported, log: Path | None) -> dict[str, str]:
    """The odometry of every run, as recorded and corrected, from its log; maps of grids have
    none."""
    poses = source.merge[1].poses if source.merge else {}
    out = {}
    for run, topomap in sorted(source.maps.items()):
        if not topomap.is_driven:
            if source.merge:
                warn(f"{run}: is the map of a grid, which nobody drove: no trajectory")
            continue
        at = log_of(place, run, log)
        odometry = read_run(at, place.ingested(run).settings()).odometry
        corrected = corrected_tum(topomap, odometry, poses.get(run))
        if corrected is None:
            raise DataError(
                f"run {run}: no junction pass of its map lies within the odometry of its log"
            )
        stem = f".{run}" if source.merge else ""
        out[f"{stem}.recorded.tum"] = recorded_tum(odometry)
        out[f"{stem}.corrected.tum"] = corrected
    return out


def _path(
    place: Workspace,
    output: Path | None,
    sources: list[Exported],
    name: str,
    *,
    alone: bool = False,
) -> Path:
    """The file of a text by its name; alone: there is no other.

    With an --output for several files, each file's own part comes before the suffix: out.csv
    becomes out.junctions.csv and out.corridors.csv. Pictures keep theirs.
    """
    if output is None:
        return place.exports / name
    if alone:
        return output
    own = name.removeprefix(sources[0].name) if len(sources) == 1 else f"-{name}"
    if own.endswith(PICTURE) or output.suffix == PICTURE:
        return output.with_name(f"{output.stem}{own}")
    return output.with_name(f"{output.stem}{own.removesuffix(output.suffix)}{output.suffix}")
