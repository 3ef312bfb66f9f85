"""Exports of simulated and real runs: read back, and judged by the truth.

python benchmarks/exports.py [--seeds 2] [--first 501] [--logs FOLDER ...]

Ten worlds (two of every kind) of two runs each, and folders of logs of real runs (without truth).
Every export of every run and of every component goes through its reader (tests/viz/exports).

  routes   shortest routes between junctions in the Nav2 graph by its `length`, against the way in
           the true world
  times    `abs_time_taken` along those routes, against what the robots truly took to drive them
  said     routes of which the graph itself says that more than one in twenty may be off by more
           (`length_sigma` with `length_scale_sigma`; `time_sigma`), and of the others those within

By length of the route: those within 2 %, and within 1 and 1.96 of the sigmas stated.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import networkx as nx
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "viz" / "exports"))
import readers

from topobatch.ingest.mapping import build_map
from topobatch.ingest.reading import find_logs, read_run
from topobatch.merge.component_map import component_map, component_pose_graph
from topobatch.merge.merging import merge_maps
from topobatch.merge.pieces import joined_pieces
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.truth import Truth, true_vertex_of_nodes
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.map_pose_graph import map_pose_graph
from topobatch.topology.odometry import Odometry
from topobatch.topology.topomap import TopoMap
from topobatch.topology.turning_vertices import with_turning_points
from topobatch.viz.exports import MAP_FORMATS
from topobatch.viz.exports.pose_graph import pose_graph_g2o
from topobatch.viz.exports.route_graph import MAX_ERROR_M
from topobatch.viz.exports.tum import corrected_tum, recorded_tum

KINDS = ("maze", "office", "organic", "city", "rows")
READERS = {
    ".geojson": readers.read_nav2,
    ".lif.json": readers.read_lif,
    ".rmf.yaml": readers.read_rmf,
    ".tmap2.yaml": readers.read_tmap2,
    ".graphml": readers.read_graphml,
    ".junctions.csv": readers.read_csv,
    ".corridors.csv": readers.read_csv,
}


@dataclass
class Tally:
    """What was read and measured: relative errors, one per route."""

    files: int = 0
    metres: list[float] = field(default_factory=list)
    routes: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    route_sigmas: list[float] = field(default_factory=list)
    time_sigmas: list[float] = field(default_factory=list)
    corridors: list[float] = field(default_factory=list)
    corridor_times: list[float] = field(default_factory=list)
    unjudged: int = 0

    def add(self, other: Tally) -> None:
        """Both together."""
        self.files += other.files
        self.unjudged += other.unjudged
        for name in _LISTS:
            getattr(self, name).extend(getattr(other, name))


_LISTS = (
    "metres", "routes", "times", "route_sigmas", "time_sigmas", "corridors", "corridor_times",
)  # fmt: skip


def read_back(topomap: TopoMap, folder: Path) -> Tally:
    """Every format that a map alone is enough for, and its pose graph."""
    whole, count = with_turning_points(topomap), 0
    for writers in MAP_FORMATS.values():
        for ending, text_of in writers.items():
            READERS[ending](text_of(whole, MAX_ERROR_M))
            count += 1
    graph = pose_graph_g2o(map_pose_graph(topomap))
    readers.read_g2o(graph, folder)
    return Tally(files=count + 1)


def read_back_tracks(topomap: TopoMap, odometry: Odometry, folder: Path) -> Tally:
    """Both trajectories of a run."""
    readers.read_tum(recorded_tum(odometry), folder)
    readers.read_tum(corrected_tum(topomap, odometry) or "", folder)
    return Tally(files=2)


def judged(topomap: TopoMap, true: np.ndarray, truth: Truth, runs: list[str]) -> Tally:
    """Routes of the Nav2 graph against the truth. true: (n,) world vertex of each vertex, < 0 for
    what is none; runs: whose drives are in the map."""
    graph = readers.read_nav2(MAP_FORMATS["nav2"][".geojson"](topomap, MAX_ERROR_M))
    simple = nx.DiGraph()
    for u, v, data in graph.edges(data=True):
        if simple.has_edge(u, v) and simple.edges[u, v]["length"] <= data["length"]:
            continue
        simple.add_edge(u, v, **data)
    scale = topomap.measured.scale  # the graph's length_scale_sigma
    known = _true_corridors(topomap, true, truth, runs)
    out, real = Tally(), [v for v in range(len(topomap)) if v in simple]
    for corridor, (length, seconds) in known.items():
        pieces = [d for *_, d in graph.edges(data=True) if d["corridor"] == corridor]
        out.corridors.append(sum(p["length"] for p in pieces) / 2 / length - 1)
        out.corridor_times.append(sum(p["abs_time_taken"] for p in pieces) / 2 / seconds - 1)
    chance = np.random.default_rng(0)
    for _ in range(200):
        start, end = chance.choice(real, 2, replace=False).tolist()
        if not nx.has_path(simple, start, end):
            continue
        way = nx.shortest_path(simple, start, end, weight="length")
        steps = [simple.edges[step] for step in pairwise(way)]
        corridors = list(dict.fromkeys(step["corridor"] for step in steps))
        if any(c not in known for c in corridors):
            out.unjudged += 1
            continue
        length, seconds = np.sum([known[c] for c in corridors], axis=0)
        out.metres.append(length)
        out.routes.append(sum(step["length"] for step in steps) / length - 1)
        out.times.append(sum(step["abs_time_taken"] for step in steps) / seconds - 1)
        out.route_sigmas.append(_sigma(steps, "length_sigma", scale) / length)
        out.time_sigmas.append(_sigma(steps, "time_sigma") / seconds)
    return out


def _sigma(steps: list[dict[str, float]], name: str, scale: float = 0.0) -> float:
    """Of a route, by its edges; without end where one states nothing."""
    lengths, sigmas = (
        np.array([step.get(n, np.inf) for step in steps], float) for n in ("length", name)
    )
    return readers.route_sigma(lengths, sigmas, scale)


def _true_corridors(
    topomap: TopoMap, true: np.ndarray, truth: Truth, runs: list[str]
) -> dict[int, tuple[float, float]]:
    """True length [m] and median true time [s] of the corridors of a map that join two junctions
    which a corridor of the world joins; left out are those that end at phantoms, or run through a
    junction that was missed."""
    world = truth.worlds[truth.runs[runs[0]].world]
    took: dict[int, list[float]] = {}
    for run in runs:
        t = truth.runs[run]
        for edge, seconds in zip(
            t.drive_edge, (t.drive_end_ns - t.drive_start_ns) / 1e9, strict=True
        ):
            took.setdefault(int(edge), []).append(float(seconds))
    between: dict[frozenset[int], list[int]] = {}
    for edge, ends in enumerate(zip(world.source.tolist(), world.target.tolist(), strict=True)):
        between.setdefault(frozenset(ends), []).append(edge)
    out = {}
    for e in range(len(topomap.source)):
        ends = frozenset((int(true[topomap.source[e]]), int(true[topomap.target[e]])))
        edges = [c for c in between.get(ends, []) if c in took]
        if edges:
            best = min(edges, key=lambda c: abs(world.length[c] - topomap.length[e]))
            out[e] = float(world.length[best]), float(np.median(took[best]))
    return out


def simulated(kind: str, seed: int, folder: Path) -> Tally:
    """Two runs of one world: their exports, and those of what they become together."""
    scenario = simulate_scenario(
        ScenarioSettings(kind, runs=2, overlap=0.5, junctions_per_run=40, seed=seed)
    )
    truth, tally = scenario.truth, Tally()
    maps = {}
    for name, run in scenario.runs.items():
        maps[name] = map_from_document(map_to_document(build_map(run)))
        tally.add(read_back(maps[name], folder))
        tally.add(read_back_tracks(maps[name], run.odometry, folder))
        tally.add(judged(maps[name], true_vertex_of_nodes(truth, maps[name]), truth, [name]))
    of = {name: true_vertex_of_nodes(truth, m) for name, m in maps.items()}
    for topomap, runs in components(maps, folder, tally):
        members = topomap.info["members"]["nodes"]
        true = np.array([_one({int(of[r][v]) for r in m for v in m[r]}) for m in members])
        tally.add(judged(topomap, true, truth, runs))
    return tally


def _one(vertices: set[int]) -> int:
    """The one world vertex that the members of a fused vertex are; -1 where they are not one."""
    real = {v for v in vertices if v >= 0}
    return real.pop() if len(real) == 1 else -1


def components(
    maps: dict[str, TopoMap], folder: Path, tally: Tally
) -> Iterator[tuple[TopoMap, list[str]]]:
    """The components of a merge, as maps; their exports are read back."""
    result = merge_maps(list(maps.values()))
    for component in result.components:
        topomap = component_map(result, component.id, f"merged-{component.id}", maps)
        tally.add(read_back(topomap, folder))
        graph = pose_graph_g2o(component_pose_graph(result, component.id, maps))
        readers.read_g2o(graph, folder)
        tally.files += 1
        yield topomap, sorted(component.poses)


def real(logs: Path, folder: Path) -> Tally:
    """Logs of real runs: what they become is read back."""
    tally, maps = Tally(), {}
    for log in find_logs([logs]):
        run = read_run(log)
        for topomap in joined_pieces(build_map(run)):
            maps[topomap.run] = map_from_document(map_to_document(topomap))
            tally.add(read_back(maps[topomap.run], folder))
            tally.add(read_back_tracks(maps[topomap.run], run.odometry, folder))
    for _ in components(maps, folder, tally):
        pass
    return tally


def line(name: str, tally: Tally) -> str:
    """One row: how many were within the bound, and the worst twentieth."""
    cells = [f"{name:14}", f"{tally.files:5}"]
    for errors, sigmas, bound in (
        (tally.routes, tally.route_sigmas, 0.02),
        (tally.times, tally.time_sigmas, 0.10),
    ):
        off, said = np.abs(errors), 1.96 * np.array(sigmas) > bound
        cells.append(
            f"{len(off):6} {np.mean(off <= bound):6.3f} {np.quantile(off, 0.95):6.3f} "
            f"{np.mean(said):6.3f} {np.mean(off[~said] <= bound) if (~said).any() else np.nan:6.3f}"
            if len(off)
            else f"{0:6}" + f" {'-':>6}" * 4
        )
    for errors in (tally.corridors, tally.corridor_times):
        cells.append(f"{np.median(np.abs(errors)):6.3f}" if errors else f"{'-':>6}")
    return "  ".join([*cells, f"{tally.unjudged:5}"])


def by_length(tally: Tally) -> str:
    """How far the routes of each length are off, and whether their sigmas are that."""
    metres, off = np.array(tally.metres), np.abs(tally.routes)
    z, rows = off / np.array(tally.route_sigmas), ["route of        n  ≤ 2 %   68 %   95 %"]
    for low, high in pairwise((0, 5, 10, 20, np.inf)):
        of = (low <= metres) & (metres < high)
        shares = (np.mean(x) for x in (off[of] <= 0.02, z[of] <= 1, z[of] <= 1.96))
        rows.append(f"{low:2} to {high:3} m {of.sum():6}" + "".join(f"{x:7.3f}" for x in shares))
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=501)
    parser.add_argument("--logs", type=Path, nargs="*", default=[])
    args = parser.parse_args()
    print(
        "world           files  routes  ≤ 2 %    p95   said others   times ≤ 10 %    p95   said "
        "others  corridor: length, time  not judged"
    )
    start, total = time.monotonic(), Tally()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in KINDS:
            for seed in range(args.first, args.first + args.seeds):
                tally = simulated(kind, seed, folder)
                total.add(tally)
                print(line(f"{kind} {seed}", tally), flush=True)
        if total.routes:
            print(line("together", total), by_length(total), sep="\n")
        for logs in args.logs:
            print(line(logs.name if logs.name != "logs" else logs.parent.name, real(logs, folder)))
    print(f"{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
