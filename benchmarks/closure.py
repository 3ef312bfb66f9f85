"""How often loop closure is right: python benchmarks/closure.py [--seeds 5] [--growth] [--jumps]

Runs of the project's own simulator in four kinds of world (`--worlds`), by drift and faults. A run
is *consistent* if no junction stands twice in its map and no vertex holds two. `false` are passes
in a vertex that is mostly another junction, per 100 passes. Edges are right if their vertices are
joined in the world, and wanted if driven between two reported passes; phantoms are passed over, and
what leads past a junction that was never reported is no error. `rmse` is of the vertices after the
best rigid fit. `resets`: the odometry starts anew once or twice a run; of pieces that stay apart
the largest is judged, and such a run is not consistent. `--growth` measures CPU time against the
length of a run instead. `--wrong-noise F` gives the closure a noise that is F times what the run
shows.

`--jumps frame` lets the odometry's frame jump once in every run, by so many metres and degrees, and
reads the run as from a log: `recall` are the passes by a junction passed before that stand in one
vertex with such a pass, `across` the first of every junction past the jump among them; `cut` are
runs that come in several maps; `false`, `mixed` and `double` are counts. `--jumps late`: the
odometry stands until it leaps to where the robot is; `--jumps robot`: the robot is moved at once,
and the odometry has seen it; `--jumps both`: and its frame has jumped as well.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np

from topobatch.ingest import mapping, pass_source
from topobatch.ingest.odometry.calibration import apply_calibration, calibrate
from topobatch.ingest.odometry.noise import estimate_noise
from topobatch.ingest.odometry.track import sane_track
from topobatch.ingest.passes import fuse_passes
from topobatch.merge.pieces import joined_pieces
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import DRIFTS, ScenarioSettings
from topobatch.simulation.truth import true_vertex_of_passes
from topobatch.topology.closure.alternatives import most_likely_closure
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.incremental import full_closure
from topobatch.topology.closure.missed_detections import correct_detections
from topobatch.topology.closure.variance_components import fitted_noise
from topobatch.topology.se2 import apply, between, compose, fit_rigid

WORLDS = ("maze", "office", "organic", "city")
CELLS = (
    ("low", "none"),
    ("low", "mild"),
    ("mid", "mild"),
    ("high", "none"),
    ("high", "mild"),
    ("low", "harsh"),
    ("mid", "harsh"),
    ("high", "harsh"),
    ("real", "mild"),
    ("resets", "mild"),
)
JUMPS = ((0.0, 0.0), (0.1, 5.0), (0.5, 15.0), (0.5, 45.0), (2.0, 90.0))
"""Metres and degrees; the first is no jump, for comparison."""
RESETS = replace(DRIFTS["mid"], resets_per_100_m=0.15)


def simulated(world, drift, faults, seed, junctions):
    """One run, alone in its world."""
    scenario = simulate_scenario(
        ScenarioSettings(
            world=world,
            runs=1,
            junctions_per_run=junctions,
            drift=RESETS if drift == "resets" else drift,
            faults=faults,
            seed=seed,
        )
    )
    (name,) = scenario.runs
    return scenario, scenario.runs[name]


def jumping(world, drift, faults, seed, *, junctions, size):
    """Truth and run whose odometry's frame jumps once by size [m, deg]; as read from a log."""
    metres, degrees = size
    jump = {"jumps": 1, "jump_m": metres, "jump_deg": degrees} if metres + degrees else {}
    scenario, run = simulated(world, replace(DRIFTS[drift], **jump), faults, seed, junctions)
    return scenario.truth, as_read(run)


def driven(world, drift, faults, seed, *, junctions, size, late=False, slipping=False):
    """Truth and run in which the robot itself goes the way of the jump, about size [m, deg].

    late: its odometry stands meanwhile, and then leaps to where the robot is; else no time passes
    for it, nor for the detector: the robot is moved, and the odometry has seen it. slipping: what
    it has seen is wrong by a jump of the same size.
    """
    metres, degrees = size
    scenario, run = simulated(world, drift, faults, seed, junctions)
    truth, odometry = scenario.truth, run.odometry
    pose, way = odometry.pose, np.cumsum(odometry.step_m)
    turned = np.unwrap(pose[:, 2])
    begin = np.random.default_rng(seed).permutation(np.arange(len(way) // 4, len(way) * 3 // 4))
    end = np.searchsorted(way, way[begin] + metres)
    fits = np.abs(np.abs(turned[end] - turned[begin]) - np.radians(degrees)) < 0.1
    if not metres or not fits.any():
        return truth, as_read(run)
    first, last = int(begin[fits][0]), int(end[fits][0])
    told = replace(truth.runs[run.name], jump_ns=(int(odometry.time_ns[last]),))
    if late:
        pose = pose.copy()
        pose[first:last] = pose[first]
        run = replace(run, odometry=replace(odometry, pose=pose))
    else:
        if slipping:
            pose = slipped(pose, last, size, seed, turned[last] - turned[first])
            run = replace(run, odometry=replace(odometry, pose=pose))
        run, told = left_out(run, told, first, last)
    return replace(truth, runs={run.name: told}), as_read(run)


def slipped(pose, row, size, seed, sense):
    """The poses with a jump of that size into the row, turned in that sense, whither by chance."""
    whither = np.random.default_rng(seed).uniform(-np.pi, np.pi)
    turn = np.copysign(np.radians(size[1]), sense)
    jump = [size[0] * np.cos(whither), size[0] * np.sin(whither), turn]
    moved = compose(compose(pose[row], jump), between(pose[row], pose[row:]))
    return np.concatenate([pose[:row], moved])


def left_out(run, told, first, last):
    """The run and its truth as if no time had passed between two rows of the odometry."""
    odometry, seen = run.odometry, run.detections
    begin, end = int(odometry.time_ns[first]), int(odometry.time_ns[last - 1])

    def clock(time_ns):
        time_ns = np.asarray(time_ns)
        return np.where(time_ns > end, time_ns - (end - begin), np.minimum(time_ns, begin))

    rows = np.delete(np.arange(len(odometry)), np.arange(first + 1, last))
    kept = np.flatnonzero((seen.time_ns <= begin) | (seen.time_ns > end))
    names = ("start_ns", "end_ns", "drive_start_ns", "drive_end_ns", "path_ns", "jump_ns")
    times = {name: clock(getattr(told, name)) for name in names}
    odometry = replace(odometry, time_ns=clock(odometry.time_ns[rows]), pose=odometry.pose[rows])
    seen = replace(
        seen,
        time_ns=clock(seen.time_ns[kept]),
        centre=seen.centre[kept],
        branches=seen.branches.take(kept),
    )
    return replace(run, odometry=odometry, detections=seen), replace(told, **times)


def as_read(run):
    """The run with what reading makes of its odometry."""
    track = sane_track(run.odometry.time_ns, run.odometry.pose, "odom", "base_link")
    return replace(run, odometry=track.odometry, warnings=track.warnings)


def revisits(truth, name, maps):
    """Passes by junctions passed before, those found, and both of the first ones past a jump."""
    of_run = truth.runs[name]
    seen = np.flatnonzero(of_run.messages > 0)
    middle = (of_run.start_ns[seen] + of_run.end_ns[seen]) // 2
    nodes = [set() for _ in seen]
    for k, topomap in enumerate(maps):
        vertex = true_vertex_of_passes(truth, name, topomap.observation_time_ns)
        rows = zip(vertex, topomap.observation_time_ns, topomap.observation_vertex, strict=True)
        for v, time_ns, node in rows:
            mine = np.flatnonzero(of_run.vertex[seen] == v)
            if len(mine):
                nodes[mine[np.abs(middle[mine] - time_ns).argmin()]].add((k, int(node)))
    jump_ns = min(of_run.jump_ns, default=np.iinfo(np.int64).max)
    earlier, past = {}, set()
    count = Counter()
    for k in np.argsort(middle, kind="stable").tolist():
        v = int(of_run.vertex[seen[k]])
        if v in earlier:
            found = bool(nodes[k] & earlier[v])
            across = middle[k] > jump_ns and v not in past
            count += Counter(revisits=1, found=found, across=across, met=found and across)
        if middle[k] > jump_ns:
            past.add(v)
        earlier.setdefault(v, set()).update(nodes[k])
    return count


JUMPING = {
    "frame": jumping,
    "late": partial(driven, late=True),
    "robot": driven,
    "both": partial(driven, slipping=True),
}


def judge(truth, run, topomap):
    """Counts for one map."""
    of_pass = true_vertex_of_passes(truth, run.name, topomap.observation_time_ns)
    node = topomap.observation_vertex
    real = of_pass >= 0
    homes = Counter(zip(of_pass[real].tolist(), node[real].tolist(), strict=True))
    holders = Counter(v for v, _ in homes)
    label, misplaced, mixed = {}, 0, 0
    for n in range(len(topomap)):
        held = {v: k for (v, m), k in homes.items() if m == n}
        if held:
            label[n] = max(sorted(held), key=held.__getitem__)
            misplaced += sum(held.values()) - held[label[n]]
            mixed += len(held) > 1
    duplicates = sum(k - 1 for k in holders.values())
    right, wrong, missing = judge_edges(truth, run.name, topomap, label)
    world = truth.worlds[truth.runs[run.name].world]
    nodes = sorted(label)
    there = world.xy[[label[n] for n in nodes]]
    T = fit_rigid(there, topomap.xy[nodes])
    off = apply(T, topomap.xy[nodes]) - there
    return {
        "passes": int(real.sum()),
        "misplaced": misplaced,
        "mixed": mixed,
        "duplicates": duplicates,
        "edges_right": right,
        "edges_wrong": wrong,
        "edges_missing": missing,
        "rmse": float(np.sqrt((off**2).sum(axis=1).mean())),
    }


def judge_edges(truth, name, topomap, label):
    """Edges right, wrong, missing; vertices that stand for no junction are passed over."""
    of_run = truth.runs[name]
    world = truth.worlds[of_run.world]
    pairs = [tuple(sorted(pair)) for pair in zip(world.source, world.target, strict=True)]
    between = Counter(pairs)
    ends = zip(topomap.source.tolist(), topomap.target.tolist(), strict=True)
    known = dissolved(list(ends), label)
    drawn = Counter(tuple(sorted(pair)) for pair in known)
    right = sum(min(k, between[pair]) for pair, k in drawn.items())
    # Past a junction that was never reported there is no better edge.
    hidden = {v for v in range(len(world.xy)) if v not in of_run.detected}
    beside = {v: {a if b == v else b for a, b in pairs if v in (a, b)} for v in hidden}
    forgiven = sum(
        k
        for (a, b), k in drawn.items()
        if not between[a, b] and any({a, b} <= beside[v] for v in hidden)
    )
    seen = of_run.messages > 0
    wanted = set()
    for edge, start, end in zip(
        of_run.drive_edge.tolist(),
        of_run.drive_start_ns.tolist(),
        of_run.drive_end_ns.tolist(),
        strict=True,
    ):
        met = {
            int(v)
            for v, s, e, ok in zip(of_run.vertex, of_run.start_ns, of_run.end_ns, seen, strict=True)
            if ok and v in pairs[edge] and s <= end and e >= start
        }
        if met == set(pairs[edge]):
            wanted.add(pairs[edge])
    return right, sum(drawn.values()) - right - forgiven, sum(drawn[pair] == 0 for pair in wanted)


def dissolved(ends, label):
    """Pairs of world vertices that edges join, through vertices that stand for no junction."""
    at = {}
    for e, pair in enumerate(ends):
        for n in pair:
            at.setdefault(n, set()).add(e)
    joined = dict(enumerate(ends))
    for n in [n for n in at if n not in label and len(at[n]) == 2]:
        i, j = sorted(at[n])
        a, b = (joined[e][0] if joined[e][1] == n else joined[e][1] for e in (i, j))
        del joined[j]
        joined[i] = (a, b)
        at[b] = at[b] - {j} | {i}
    return [(label[u], label[v]) for u, v in joined.values() if u in label and v in label]


def table(worlds, seeds, junctions, first, wrong_noise):
    """One line per drift and faults."""
    if wrong_noise != 1.0:
        spoil(wrong_noise)
    print(
        f"{'drift-faults':<14} {'runs':>4} {'consistent':>10} {'false/100':>9} {'mixed':>5}"
        f" {'double':>6} {'edge P':>7} {'edge R':>7} {'rmse m':>7} {'s/run':>6}"
    )
    for drift, faults in CELLS:
        rows, spent = [], 0.0
        for world in worlds:
            for seed in range(first, first + seeds):
                scenario, run = simulated(world, drift, faults, seed, junctions)
                begin = time.process_time()
                topomap, *others = joined_pieces(mapping.build_map(run))
                spent += time.process_time() - begin
                rows.append(judge(scenario.truth, run, topomap) | {"others": len(others)})
        total = {key: sum(row[key] for row in rows) for key in rows[0]}
        good = sum(row["duplicates"] + row["mixed"] + row["others"] == 0 for row in rows)
        right = total["edges_right"]
        print(
            f"{drift + '-' + faults:<14} {len(rows):>4} {good / len(rows):>10.3f}"
            f" {100 * total['misplaced'] / max(total['passes'], 1):>9.3f} {total['mixed']:>5}"
            f" {total['duplicates']:>6} {right / max(right + total['edges_wrong'], 1):>7.4f}"
            f" {right / max(right + total['edges_missing'], 1):>7.4f}"
            f" {total['rmse'] / len(rows):>7.3f} {spent / len(rows):>6.2f}",
            flush=True,
        )


def jump_table(args):
    """One line per drift, faults and size of the jump."""
    print(
        f"{'drift-faults':<12} {'m':>4} {'deg':>4} {'runs':>4} {'recall':>7} {'across':>7}"
        f" {'of':>5} {'cut':>4} {'false':>5} {'mixed':>5} {'double':>6} {'edge P':>7}"
        f" {'rmse m':>7} {'s/run':>6}"
    )
    for drift in args.drifts:
        for faults in ("none", "mild"):
            for size in JUMPS:
                total = Counter()
                for world in args.worlds:
                    for seed in range(args.first, args.first + args.seeds):
                        total.update(jump_counts(args, world, drift, faults, seed, size))
                right, runs = total["edges_right"], total["runs"]
                print(
                    f"{drift + '-' + faults:<12} {size[0]:>4} {size[1]:>4.0f} {runs:>4}"
                    f" {total['found'] / max(total['revisits'], 1):>7.4f}"
                    f" {total['met'] / max(total['across'], 1):>7.4f} {total['across']:>5}"
                    f" {total['cut']:>4} {total['misplaced']:>5} {total['mixed']:>5}"
                    f" {total['duplicates']:>6}"
                    f" {right / max(right + total['edges_wrong'], 1):>7.4f}"
                    f" {total['rmse'] / runs:>7.3f} {total['spent'] / runs:>6.2f}",
                    flush=True,
                )


def jump_counts(args, *of_run):
    """What became of one run: counts, and seconds spent."""
    world, drift, faults, seed, size = of_run
    make = JUMPING[args.jumps]
    truth, run = make(world, drift, faults, seed, junctions=args.junctions, size=size)
    begin = time.process_time()
    maps = joined_pieces(mapping.build_map(run))
    total = Counter(runs=1, cut=len(maps) > 1, spent=time.process_time() - begin)
    total.update(revisits(truth, run.name, maps))
    for topomap in maps:
        total.update(judge(truth, run, topomap))
    return total


def spoil(factor):
    """Let the mapping believe in a noise and in fault rates that are `factor` times as large."""

    def wrong(*args, **more):
        noise = estimate_noise(*args, **more)
        names = noise.__dataclass_fields__
        return replace(noise, **{name: getattr(noise, name) * factor for name in names})

    pass_source.estimate_noise = wrong


def growth(seed):
    """CPU seconds of the steps against the number of passes."""
    steps = ("calibration", "noise", "closure", "its noise", "alternatives", "settling")
    print(f"{'passes':>7} {'places':>7} " + " ".join(f"{s:>12}" for s in steps))
    for junctions in (100, 300, 750, 2250):
        _, run = simulated("maze", "mid", "mild", seed, junctions)
        clock = [time.process_time()]
        odometry = apply_calibration(run.odometry, calibrate(run.odometry, run.detections))
        clock.append(time.process_time())
        passes = fuse_passes(odometry, run.detections)
        noise = estimate_noise(odometry, run.detections, passes)
        clock.append(time.process_time())
        reckoning = dead_reckoning(odometry, passes, noise)
        first = full_closure(reckoning)
        clock.append(time.process_time())
        fit = fitted_noise(reckoning, odometry, first.place, first.estimate, grid=first.grid)
        clock.append(time.process_time())
        closed = most_likely_closure(reckoning, first, fit.reckoning)
        clock.append(time.process_time())
        corrected = correct_detections(reckoning, odometry, closed.place, closed.estimate)
        clock.append(time.process_time())
        print(
            f"{len(passes):>7} {len(corrected.xy):>7} "
            + " ".join(f"{s:>12.2f}" for s in np.diff(clock)),
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="+", default=WORLDS, help="kinds of world, also: rows")
    parser.add_argument("--seeds", type=int, default=5, help="runs per world and cell")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--junctions", type=int, default=60, help="junctions per run")
    parser.add_argument("--wrong-noise", type=float, default=1.0)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--jumps", choices=sorted(JUMPING), help="one jump per run: of what")
    parser.add_argument("--drifts", nargs="+", default=("low", "mid", "high"), help="of --jumps")
    args = parser.parse_args()
    if args.growth:
        growth(args.first)
    elif args.jumps:
        jump_table(args)
    else:
        table(args.worlds, args.seeds, args.junctions, args.first, args.wrong_noise)


if __name__ == "__main__":
    main()
