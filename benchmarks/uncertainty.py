"""Coverage of stated uncertainties.

    python benchmarks/uncertainty.py [--seeds 2] [--first 1] [--runs 3] [--worst]

How often the truth lies within the 68.3, 95 and 99.7 % intervals stated by documents and merges:

  length     a corridor's length (`length_sigma`)
  straight   the same of those at most 2 % longer than the line between their ends: of recorded
             runs the truth of others is a skeleton's, and robots cut its corners
  near, far  the position of one junction relative to another one, at most 15 m, at least 30 m away
  size       the size of the map as a whole: one error per run, mostly that of its odometry's scale
  heading    a branch in the map's frame (`branch_sigmas`)
  place      a junction's position, after a rigid fit of the map to the truth (`sigma_m`)
  fused      a corridor's length in the fused map; fused straight: as above
  fused place  the position of a junction of the fused map
  transform  the relative position of the centres of two merged runs' maps, as the radius that
             holds the share (`transform_sigma` states that of 68.3 %)
  turn       the relative rotation of the two (`transform_sigma`)
  placed     the same two for runs that are joined only through others (`placed`)

Runs of the project's simulator, three to a world, each overlapping the one before, or one to a
world (`--runs 1`: no merges, and many more worlds in the same time); for each quantity a row for
every kind of world and drift, over all faults, and one for every drift and faults, over all worlds.
`--worst` prints, for every quantity and drift, all worlds together, and the kinds of world with the
largest deviations. No two scenarios share random numbers, since an odometry's scale error is one
draw per run and dominates the errors of far junctions. `n` is the number of statements; standard
errors count all statements about one run (of merges: one world) as one draw, since their errors are
correlated. Wrongly identified junctions, corridors and pairs are left out: `closure.py` and
`chain.py` count those. A map's frame is arbitrary, so that maps are fitted rigidly to the truth.

`--laser`: junctions found in scans; faults are those of the laser and its surroundings. `--real
FOLDER…`: recorded runs, in folders with `truth.json` (vertices and edges of the world, passes of
every run) and `logs/`; `--parts N…` cuts each into this many runs of equal length. These are drives
of one robot, whose scale error is one draw for all parts. The truth has errors itself: for folders
with scans, those of its junctions against the consensus of all scans of a run (`revisits.py`) are
printed before the table. A few drives are few draws, and nearly all errors of a map are of a few
bends of it: below each quantity stands how many would lie within if the truth were what maps and
merges state, and how often so few would by chance.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from laser import bent_onto, logs
from revisits import revisits
from scipy.stats import chi2

from topobatch.ingest.mapping import build_map_with_errors
from topobatch.ingest.reading import read_run
from topobatch.merge.merging import merge_maps
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import DRIFTS, FAULTS, ScenarioSettings
from topobatch.simulation.truth import RunTruth, Truth, true_vertex_of_nodes
from topobatch.simulation.world import World
from topobatch.simulation.worlds import WORLDS
from topobatch.simulation.writing import write_run
from topobatch.topology.errors import UsageError
from topobatch.topology.odometry import Odometry
from topobatch.topology.polyline import simplify
from topobatch.topology.run import Detections, Run
from topobatch.topology.se2 import apply, between, fit_rigid, inverse, wrap

SHARES = (0.6827, 0.95, 0.9973)
QUANTITIES = (
    "length", "straight", "near", "far", "size", "place", "heading", "fused", "fused straight",
    "fused place", "transform", "turn", "placed", "placed turn",
)  # fmt: skip
NEAR_M, FAR_M = 15.0, 30.0
STRAIGHT = 0.98
WIDTH_M = 1.4
"""Of the corridors of worlds seen by lasers."""
MOST_PAIRS = 60
"""Pairs of junctions judged per run, near and far."""
DRAWS = 1000
"""Of the errors of recorded runs, as stated: a percentage is known to two points."""
MISTAKEN_RAD = 0.4
"""A branch farther than this from every true one was invented: no error of a heading."""
RASTER_M = 0.1
"""Cells of the grids whose skeletons are the corridors of recorded buildings: a path of cells is a
staircase, which is longer than what it follows."""


def quantiles(z2, freedom):
    """(k, 3) whether squared errors in units of their variance lie within each share."""
    return np.asarray(z2)[:, None] <= chi2.ppf(SHARES, freedom)


def true_lengths(truth, runs, graph, label):
    """(edges of a graph, true lengths, whether straight) of corridors that were driven and are the
    only ones between their junctions; of two edges between the same two vertices the one that fits.
    A junction that stands twice in the graph may have its corridors twice: both are stated, both
    are judged."""
    world = truth.worlds[truth.runs[runs[0]].world]
    driven = {int(e) for run in runs for e in truth.runs[run].drive_edge}
    there, here = defaultdict(list), defaultdict(list)
    for e, ends in enumerate(zip(world.source.tolist(), world.target.tolist(), strict=True)):
        there[tuple(sorted(ends))].append(e)
    for e, ends in enumerate(zip(graph.source.tolist(), graph.target.tolist(), strict=True)):
        here[tuple(sorted(ends))].append(e)
    edges, true, straight = [], [], []
    for ends, mine in here.items():
        corridors = there[tuple(sorted(label[list(ends)].tolist()))]
        if len(corridors) == 1 and corridors[0] in driven:
            goal = world.length[corridors[0]]
            edges.append(min(mine, key=lambda e: abs(graph.length[e] - goal)))
            true.append(goal)
            u, v = world.xy[[world.source[corridors[0]], world.target[corridors[0]]]]
            straight.append(np.hypot(*(u - v)) > STRAIGHT * goal)
    return np.array(edges, np.int64), np.array(true), np.array(straight, bool)


def judge_lengths(truth, runs, graph, label):
    """(k, 3) within of all lengths, and (j, 3) of the straight ones."""
    edges, true, straight = true_lengths(truth, runs, graph, label)
    z2 = ((graph.length[edges] - true) / graph.length_sigma[edges]) ** 2
    within = quantiles(z2, 1)
    return within, within[straight]


def labels(truth, topomap):
    """(n,) true vertex of every vertex of a map, negative for none; of scans, which show what the
    detector does not, by place as well: within a corridor's width of where the others put it."""
    label = true_vertex_of_nodes(truth, topomap)
    if topomap.shows_bends:
        return label
    there = truth.worlds[truth.runs[topomap.run].world].xy
    while (known := np.flatnonzero(label >= 0)).size > 3:
        T_map_world = fit_rigid(topomap.xy[known], there[label[known]])
        off = np.hypot(*(topomap.xy[known] - apply(T_map_world, there[label[known]])).T)
        if off.max() < WIDTH_M:
            break
        label[known[off.argmax()]] = -1
    return label


def judge_places(topomap, known, shape, off, seed):
    """{quantity: (k, 3) within} of errors (k, 2) of the known vertices of a map, of which `shape`
    (k, 2, s) are samples as the map states them."""
    out = {"place": within_sigma(off, topomap.position_sigma[known])}
    arm = topomap.xy[known] - topomap.xy[known].mean(axis=0)
    larger = np.einsum("ki,kis->s", arm, shape)
    out["size"] = quantiles([(arm * off).sum() ** 2 / np.mean(larger**2)], 1)
    apart = np.hypot(*(arm[:, None] - arm).transpose(2, 0, 1))
    rng = np.random.default_rng(seed)
    for name, low, high in (("near", 0.0, NEAR_M), ("far", FAR_M, np.inf)):
        i, j = np.nonzero(np.triu((apart >= low) & (apart < high), 1))
        chosen = rng.permutation(len(i))[:MOST_PAIRS]
        i, j = i[chosen], j[chosen]
        step, error = off[j] - off[i], shape[j] - shape[i]
        spread = np.einsum("kis,kjs->kij", error, error) / error.shape[2]
        told = np.linalg.inv(spread + 1e-9 * np.eye(2))
        out[name] = quantiles(np.einsum("ki,kij,kj->k", step, told, step), 2)
    return out


def known_places(truth, topomap, errors):
    """(label, known, samples) of a map: the true vertex of each vertex (negative for none), rows of
    those that have one, and samples (k, 2, s) of their errors after a rigid fit to the truth."""
    label = labels(truth, topomap)
    known = np.flatnonzero(label >= 0)
    shape = errors.as_a_whole(topomap.xy, np.where(label >= 0, 0, 1))
    return label, known, shape.sample[known, :2]


def judge_map(truth, topomap, errors, seed, headings):
    """{quantity: (k, 3) within} of one map; headings: the branches of each world's vertices."""
    label, known, shape = known_places(truth, topomap, errors)
    lengths = judge_lengths(truth, [topomap.run], topomap, label)
    out = dict(zip(("length", "straight"), lengths, strict=True))
    if len(known) < 4:
        return out
    world = truth.worlds[truth.runs[topomap.run].world]
    T_map_world = fit_rigid(topomap.xy[known], world.xy[label[known]])
    off = topomap.xy[known] - apply(T_map_world, world.xy[label[known]])
    out |= judge_places(topomap, known, shape, off, seed)
    z2 = []
    for n in known.tolist():
        true = headings[truth.runs[topomap.run].world][int(label[n])] + T_map_world[2]
        turn = wrap(topomap.branches[n][:, None] - true)
        turn = np.take_along_axis(turn, np.abs(turn).argmin(axis=1)[:, None], axis=1)[:, 0]
        z = turn / topomap.branch_sigma[n]
        z2 += (z[np.abs(turn) < MISTAKEN_RAD] ** 2).tolist()
    out["heading"] = quantiles(z2, 1)
    return out


def within_sigma(off, sigma):
    """(k, 3) whether errors (k, 2) in the plane lie within what a sigma per coordinate says."""
    return quantiles((off**2).sum(axis=1) / sigma**2, 2)


def drawn_map(truth, topomap, errors, seed):
    """{quantity: (s, 3) within} of errors drawn as a map states them."""
    _, known, shape = known_places(truth, topomap, errors)
    if len(known) < 4:
        return {}
    draws = [judge_places(topomap, known, shape, off, seed) for off in np.moveaxis(shape, 2, 0)]
    return {name: np.array([draw[name].sum(axis=0) for draw in draws]) for name in draws[0]}


def drawn_merge(merged, draws, rng):
    """[{quantity: (draws, 3) within}] of the placements of the runs of each component, drawn as it
    states them."""
    out = []
    for component in merged.components:
        spread, count = component.spread, len(component.poses)
        if spread is None:  # a run alone
            continue
        own = {run: k for k, run in enumerate(spread.runs)}
        pairs = [v for v in merged.verdicts if v.a in own and v.b in own]
        whole = np.zeros((count, 3, count, 3))
        whole[np.arange(count), :, np.arange(count)] = spread.own
        for key, block in zip(spread.key.tolist(), spread.cross, strict=True):
            i, j = divmod(key, count)
            whole[i, :, j], whole[j, :, i] = block, block.T
        error = rng.multivariate_normal(
            np.zeros(3 * count), whole.reshape(3 * count, -1), draws, check_valid="raise"
        ).reshape(draws, count, 3)
        found = defaultdict(lambda: np.zeros((draws, 3)))
        for v in pairs:
            i, j = own[v.a], own[v.b]
            step = spread.middle[j] - spread.middle[i]
            off, turn = (error[:, j] - error[:, i])[:, :2], error[:, [i, j], 2]
            both = [off - turn[:, [k]] * [-step[1], step[0]] for k in (0, 1)]
            metres = np.sqrt(np.mean([(e**2).sum(axis=1) for e in both], axis=0))
            radii = [spread.sigmas([(v.a, v.b)], share)[0][0] for share in SHARES]
            sigma = spread.sigmas([(v.a, v.b)])[0][1]
            names = ("transform", "turn") if v.accepted else ("placed", "placed turn")
            found[names[0]] += metres[:, None] <= radii
            found[names[1]] += quantiles((turn[:, 1] - turn[:, 0]) ** 2 / sigma**2, 1)
        out.append(dict(found))
    return out


def judge_merge(truth, maps, merged):
    """{quantity: (k, 3) within} of one merge."""
    labels = {m.run: true_vertex_of_nodes(truth, m) for m in maps}
    fused = merged.fused
    of_fused = np.full(len(fused), -1, np.int64)
    for n in np.flatnonzero(~fused.is_turned).tolist():
        members = fused.members[n]
        seen = {int(labels[run][v]) for run, vs in members.items() for v in vs}
        of_fused[n] = seen.pop() if len(seen) == 1 else -1
    out = defaultdict(list)
    for component in merged.components:
        runs = sorted(component.poses)
        if len(runs) > 1 and len({truth.runs[run].world for run in runs}) == 1:
            mine = np.where(fused.component == component.id, of_fused, -1)
            lengths = judge_lengths(truth, runs, fused, mine)
            for name, within in zip(("fused", "fused straight"), lengths, strict=True):
                out[name].append(within)
            known = np.flatnonzero(mine >= 0)
            there = truth.worlds[truth.runs[runs[0]].world].xy[mine[known]]
            T_world = fit_rigid(fused.xy[known], there)
            off = fused.xy[known] - apply(T_world, there)
            out["fused place"].append(within_sigma(off, fused.position_sigma[known]))
    home = {run: c for c in merged.components for run in c.poses}
    by_run = {m.run: m for m in maps}
    for v in merged.verdicts:
        told = v.transform_sigma if v.accepted else v.placed
        if told is None or truth.runs[v.a].world != truth.runs[v.b].world:
            continue
        error = placing_error(truth, by_run[v.a], by_run[v.b], labels, home[v.a].poses)
        if error is None:
            continue
        names = ("transform", "turn") if v.accepted else ("placed", "placed turn")
        spread = home[v.a].spread
        radii = [spread.sigmas([(v.a, v.b)], share)[0][0] for share in SHARES]
        out[names[0]].append(error[:1] <= np.array([radii]))
        out[names[1]].append(quantiles([(error[1] / told[1]) ** 2], 1))
    return {name: np.concatenate(rows) for name, rows in out.items()}


def placing_error(truth, a, b, labels, poses):
    """(m, rad) by which a and b are misplaced in one another (root mean square of both ways to see
    it); None where they were laid over one another wrongly."""
    T_world = {}
    for m in (a, b):
        known = np.flatnonzero(labels[m.run] >= 0)
        world = truth.worlds[truth.runs[m.run].world]
        if len(known) < 4:
            return None
        T_world[m.run] = fit_rigid(world.xy[labels[m.run][known]], m.xy[known])
    true = between(T_world[a.run], T_world[b.run])
    found = between(poses[a.run], poses[b.run])
    both = ((found, true, b), (inverse(found), inverse(true), a))
    off = [apply(T, m.xy.mean(axis=0)) - apply(T_true, m.xy.mean(axis=0)) for T, T_true, m in both]
    off = float(np.sqrt(np.mean(np.square(off).sum(axis=1))))
    turn = float(abs(wrap(found[2] - true[2])))
    return None if off > 5.0 or turn > 0.3 else (off, turn)


def judged(truth, whole, merged, seed, headings=None):
    """[(quantity, k, [within 68, 95, 99.7])] of what `mapped` gives; headings: as of `judge_map`,
    those of the world's corridors where they are left out."""
    headings = headings or {name: world.branches for name, world in truth.worlds.items()}
    rows = []
    for topomap, errors in whole:
        rows += judge_map(truth, topomap, errors, seed, headings).items()
    if merged:
        rows += judge_merge(truth, [m for m, _ in whole], merged).items()
    return [(name, len(w), w.sum(axis=0).tolist()) for name, w in rows if len(w)]


def drawn(truth, whole, merged, seed):
    """[{quantity: (DRAWS, 3) within}] of errors drawn as what `mapped` gives states them."""
    rng = np.random.default_rng(seed)
    # Samples of two maps may come of the same random numbers.
    maps = [drawn_map(truth, m, errors, seed) for m, errors in whole]
    mixed = [{k: rng.choice(w, DRAWS) for k, w in found.items()} for found in maps]
    return mixed + (drawn_merge(merged, DRAWS, rng) if merged else [])


def mapped(runs):
    """The maps (of one piece) of some runs, with their errors, and their merge if there are two."""
    built = [build_map_with_errors(run) for run in runs.values()]
    whole = [(m, errors) for m, errors in built if m.pieces == 1]
    return whole, merge_maps([m for m, _ in whole]) if len(whole) > 1 else None


def simulated(task):
    """One scenario: (world, drift, faults), and what came of it."""
    scenario, seed = scenario_of(task)
    if scenario is None:
        return task[:3], []
    return task[:3], judged(scenario.truth, *mapped(by_logs(scenario)), seed)


def scenario_of(task):
    """The scenario of (world, drift, faults, number, runs, junctions, with a laser), None where
    such a world has no room, and its seed."""
    world, drift, faults, number, runs, junctions, laser = task
    seed = zlib.crc32(f"{world} {drift} {faults} {runs} {number}".encode())
    settings = ScenarioSettings(world, runs, 0.4, junctions, drift=drift, faults=faults, seed=seed)
    if laser:
        # The detector's passes tell which junction was driven by when: it misses none.
        settings = replace(settings, faults="none", laser=faults, tells_junctions=False)
    try:
        return simulate_scenario(settings), seed
    except UsageError:
        return None, seed


def by_logs(scenario):
    """{name: run} of a scenario, as `topobatch ingest` reads their logs: what the odometry jumps by
    is found there, and junctions in scans."""
    with TemporaryDirectory() as folder:
        logs = [write_run(Path(folder), run) for run in scenario.simulated]
        return {log.stem: read_run(log) for log in logs}


def recorded(folder):
    """(truth, runs, headings of the branches) of a folder with logs and the true world."""
    doc = json.loads((folder / "truth.json").read_bytes())
    worlds, headings = {}, {}
    for name, w in doc["worlds"].items():
        xy = np.array([(v["x"], v["y"]) for v in w["vertices"]])
        ends = np.array([(e["source"], e["target"]) for e in w["edges"]])
        keep = np.flatnonzero(ends[:, 0] != ends[:, 1])
        paths = [
            simplify(np.array([xy[s], *w["edges"][k]["path"][1:-1], xy[t]]), RASTER_M)
            for k, (s, t) in zip(keep.tolist(), ends[keep].tolist(), strict=True)
        ]
        worlds[name] = World(name, w["kind"], xy, *ends[keep].T, tuple(paths)), keep
        # What detectors reported is not where a wavering skeleton is after 0.7 m.
        headings[name] = [np.array([b["heading"] for b in v["branches"]]) for v in w["vertices"]]
    runs = {}
    for name, r in doc["runs"].items():
        passes = [p for p in r["passes"] if p["detected"]]
        number = {int(e): k for k, e in enumerate(worlds[r["world"]][1])}
        drives = [t for t in r["traversals"] if t["edge"] in number]
        runs[name] = RunTruth(
            name,
            r["world"],
            np.zeros(3),
            np.array([p["t_start_ns"] for p in passes]),
            np.array([p["t_end_ns"] for p in passes]),
            np.array([p["world_vertex"] for p in passes]),
            np.array([p["messages"] for p in passes]),
            ("",) * len(passes),
            np.array([number[t["edge"]] for t in drives]),
            np.array([r["passes"][t["passes"][0]]["t_start_ns"] for t in drives]),
            np.array([r["passes"][t["passes"][1]]["t_end_ns"] for t in drives]),
            np.zeros(0, np.int64), np.zeros((0, 3)),
        )  # fmt: skip
    logs = {name: read_run(folder / "logs" / f"{name}.mcap") for name in runs}
    return Truth({name: w for name, (w, _) in worlds.items()}, runs), logs, headings


def cut(truth, runs, count):
    """(truth, runs) with every run with detections cut into so many of equal way."""
    parts, told = {}, {}
    for name, run in runs.items():
        odometry, seen, true = run.odometry, run.detections, truth.runs[name]
        way = np.cumsum(odometry.step_m)
        first = np.searchsorted(way, way[-1] * np.arange(count + 1) / count)
        first[-1] = len(way)
        for k, (a, b) in enumerate(zip(first[:-1].tolist(), first[1:].tolist(), strict=True), 1):
            begin, end = odometry.time_ns[[a, b - 1]]
            breaks, jumps = ((rows > a) & (rows < b) for rows in (odometry.breaks, odometry.jumps))
            track = Odometry(
                odometry.time_ns[a:b],
                between(odometry.pose[a], odometry.pose[a:b]),
                odometry.breaks[breaks] - a,
                jumps=odometry.jumps[jumps] - a,
                jump_sigma=odometry.jump_sigma[jumps],
                jump_other=odometry.jump_other[jumps],
            )
            inside = np.flatnonzero((seen.time_ns >= begin) & (seen.time_ns <= end))
            detections = Detections(
                seen.time_ns[inside], seen.centre[inside], seen.branches.take(inside)
            )
            new = f"{name}-{k}of{count}"
            parts[new] = Run(new, track, detections)
            passed = (true.end_ns >= begin) & (true.start_ns <= end)
            driven = (true.drive_start_ns >= begin) & (true.drive_end_ns <= end)
            kept = {
                "start_ns": passed, "end_ns": passed, "vertex": passed, "messages": passed,
                "drive_edge": driven, "drive_start_ns": driven, "drive_end_ns": driven,
            }  # fmt: skip
            rows = {field: getattr(true, field)[mask] for field, mask in kept.items()}
            told[new] = replace(true, name=new, fault=("",) * int(passed.sum()), **rows)
    return Truth(truth.worlds, told), parts


def own_errors(folder, truth):
    """How far off the junctions of the truth are, run by run: held against where the scans that are
    laid over one another put what the truth's poses see there."""
    for log in logs(folder):
        true = truth.runs[log.name]
        path = revisits(log.odometry, log.scans, log.truth).path
        by_scans = defaultdict(list)
        for start, end, vertex in zip(true.start_ns, true.end_ns, true.vertex, strict=True):
            time = np.arange(max(start, path.time_ns[0]), min(end, path.time_ns[-1]), 200_000_000)
            if len(time):
                T_map_robot = inverse(bent_onto(log.truth, log, time))
                xy = truth.worlds[true.world].xy[[vertex]]
                there = apply(bent_onto(path, log, time), apply(T_map_robot, xy))
                by_scans[int(vertex)].append(there.mean(axis=0))
        seen = np.array([np.mean(found, axis=0) for found in by_scans.values()])
        there = truth.worlds[true.world].xy[list(by_scans)]
        off = there - apply(fit_rigid(there, seen), seen)
        arm = there - there.mean(axis=0)
        apart = np.hypot(*(there[:, None] - there).transpose(2, 0, 1))
        told = [f"size {(arm * off).sum() / (arm**2).sum():+.4f}"]
        for name, low, high in (("near", 0.0, NEAR_M), ("far", FAR_M, np.inf)):
            i, j = np.nonzero(np.triu((apart >= low) & (apart < high), 1))
            if len(i):
                told.append(f"{name} {np.sqrt(np.mean((off[j] - off[i]) ** 2)):.3f} m")
        yield f"{folder.name}, {log.name}: the truth's {len(there)} junctions {', '.join(told)} off"


def shares(cells):
    """(count, shares within, their standard errors by runs) of [(count, within)]."""
    n = np.array([count for count, _ in cells], float)
    hits = np.array([within for _, within in cells])
    share = hits.sum(axis=0) / n.sum()
    spare = np.sqrt(((hits - n[:, None] * share) ** 2).sum(axis=0)) / n.sum()
    return n, share, spare


def line(name, cells, width=22):
    """One row: counts and shares in per cent, with their standard errors by runs."""
    n, share, spare = shares(cells)
    cells = "".join(f"{100 * p:8.1f} ±{100 * e:4.1f}" for p, e in zip(share, spare, strict=True))
    return f"{name:{width}}{int(n.sum()):7}{cells}"


def table(results):
    """For every quantity: rows by world and drift, rows by drift and faults."""
    rows = defaultdict(lambda: defaultdict(list))
    for (world, drift, faults), found in results:
        for quantity, count, within in found:
            for name in (f"{world} {drift}", f"drift {drift}, {faults}", f"drift {drift}"):
                rows[quantity][name].append((count, within))
    for quantity in QUANTITIES:
        if quantity in rows:
            head = "".join(f"{format(100 * p, '.1f') + ' %':>14}" for p in SHARES)
            yield f"{quantity:22}{'n':>7}{head}"
            yield from (line(name, cells) for name, cells in sorted(rows[quantity].items()))
            yield ""


def recorded_table(results):
    """As `table`, a row for each set of runs. Where errors can be drawn as maps and merges state
    them: the shares within (mean, standard deviation), and how often so few are, or fewer."""
    for quantity in QUANTITIES:
        rows = [(name, [r[1:] for r in found if r[0] == quantity]) for name, found, _ in results]
        rows = [(name, cells) for name, cells in rows if cells]
        if not rows:
            continue
        yield f"{quantity:30}{'n':>7}" + "".join(f"{100 * p:.1f} %".rjust(14) for p in SHARES)
        every = [cell for _, cells in rows for cell in cells]
        yield from (line(name, cells, 30) for name, cells in rows)
        if len(rows) > 1:
            yield line("together", every, 30)
        told = [d[quantity] for *_, draws in results for d in draws if quantity in d]
        if told:
            n, share, _ = shares(every)
            drawn = sum(told) / n.sum()
            ends = zip(100 * drawn.mean(axis=0), 100 * drawn.std(axis=0), strict=True)
            yield f"{'  drawn as stated':37}" + "".join(f"{p:8.1f} ±{e:4.1f}" for p, e in ends)
            few = (drawn <= share + 1e-9).mean(axis=0)
            yield f"{'  of draws, as few or fewer':37}" + "".join(
                f"{100 * p:11.1f} %  " for p in few
            )
        yield ""


def worst(results):
    """For every quantity and drift: shares over all worlds, and the two worlds farthest from 68.3 %
    in either direction, with their standard errors."""
    cells = defaultdict(list)
    for (world, drift, _), found in results:
        for quantity, count, within in found:
            for name in (world, ""):
                cells[quantity, drift, name].append((count, within))
    yield "quantity     drift     n  within 68.3 95 99.7        lowest             highest"
    for quantity, drift in product(QUANTITIES, DRIFTS):
        if (quantity, drift, "") not in cells:
            continue
        n, share, spare = shares(cells[quantity, drift, ""])
        by_world = []
        for world in WORLDS:
            if (quantity, drift, world) in cells:
                _, p, e = shares(cells[quantity, drift, world])
                by_world.append((100 * p[0], 100 * e[0], world))
        ends = "  ".join(f"{p:5.0f} ±{e:3.0f} {w:8}" for p, e, w in (min(by_world), max(by_world)))
        p = 100 * share
        all_worlds = f"{p[0]:5.1f} {p[1]:5.1f} {p[2]:5.1f} ±{100 * spare[0]:4.1f}"
        yield f"{quantity:12} {drift:5} {int(n.sum()):6}  {all_worlds}  {ends}"


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS))
    parser.add_argument("--drifts", nargs="+", default=list(DRIFTS))
    parser.add_argument("--faults", nargs="+", default=list(FAULTS))
    parser.add_argument("--seeds", type=int, default=2, help="scenarios per world, drift, faults")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--runs", type=int, default=3, help="in a world; 1: none is merged")
    parser.add_argument("--junctions", type=int, default=40, help="per run")
    parser.add_argument("--laser", action="store_true", help="junctions from scans")
    parser.add_argument("--worst", action="store_true", help="the worlds that stray most")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--real", nargs="+", type=Path, help="folders of recorded runs")
    parser.add_argument("--parts", nargs="+", type=int, help="cut each recorded run into so many")
    args = parser.parse_args()
    if args.real:
        results = []
        for folder in args.real:
            truth, runs, headings = recorded(folder)
            if any(run.scanned for run in runs.values()):
                if args.parts:
                    parser.error(f"{folder}: only runs with detections are cut")
                print("\n".join(own_errors(folder, truth)))
            for count in args.parts or [None]:
                true, parts = (truth, runs) if count is None else cut(truth, runs, count)
                built = mapped(parts)
                name = folder.name + (f", {count} parts" if count else "")
                found = judged(true, *built, args.first, headings)
                results.append((name, found, drawn(true, *built, args.first)))
        print("\n".join(recorded_table(results)))
    else:
        seeds = range(args.first, args.first + args.seeds)
        cells = product(
            args.worlds,
            args.drifts,
            args.faults,
            seeds,
            [args.runs],
            [args.junctions],
            [args.laser],
        )
        if args.jobs > 1:
            with ProcessPoolExecutor(args.jobs) as pool:
                results = list(pool.map(simulated, cells))
        else:
            results = [simulated(cell) for cell in cells]
        print("\n".join((worst if args.worst else table)(results)))


if __name__ == "__main__":
    main()
