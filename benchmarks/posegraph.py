"""The pose graph on public graphs, beside GTSAM: python benchmarks/posegraph.py FILE.g2o…

    OMP_NUM_THREADS=1 python benchmarks/posegraph.py graphs/*.g2o

GTSAM comes with the tools of the tests. Files: intel, CSAIL, MIT, manhattan (M3500) and others, for
instance from github.com/david-m-rosen/SE-Sync.

Times are the best process CPU times of one thread, ours from arrays to convergence (chordal start,
ordering, Gauss–Newton), GTSAM's for `optimize()` alone, without building its graph; both begin from
the poses of the file, or from chained edges where it has none. χ² is g2o's metric for both; GTSAM
minimises another residual (the logarithm of the error), so that its minimum may score higher.
`LAGO` is GTSAM's own start for planar graphs, its time included.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import gtsam
import numpy as np

from topobatch.topology.posegraph.graph import edge_errors, squared
from topobatch.topology.posegraph.solve import Marginals, PoseGraph, solve, solve_robust
from topobatch.topology.se2 import between

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "topology" / "posegraph"))
from public_graphs import read_g2o


def best_ms(call, repeats):
    """(last result, best CPU time [ms] of so many calls)."""
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.process_time_ns()
        result = call()
        best = min(best, (time.process_time_ns() - start) / 1e6)
    return result, best


def chi2(graph, pose):
    return float(squared(edge_errors(graph, pose, np.zeros(0)), graph.information).sum())


def gtsam_problem(graph, diagonal=False):
    """GTSAM's factor graph, first pose held, and its first guess.

    diagonal: forget the correlations, which its LAGO cannot take.
    """
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.pose.tolist()):
        values.insert(k, gtsam.Pose2(*pose))
    ends = zip(graph.source.tolist(), graph.target.tolist(), strict=True)
    for (i, j), T, omega in zip(ends, graph.measurement.tolist(), graph.information, strict=True):
        if diagonal:
            model = gtsam.noiseModel.Diagonal.Precisions(np.diag(omega))
        else:
            model = gtsam.noiseModel.Gaussian.Information(omega)
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*T), model))
    tight = gtsam.noiseModel.Diagonal.Precisions(np.full(3, 1e8))
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.pose[0]), tight))
    return factors, values


def gtsam_poses(values, n):
    return np.array([[(p := values.atPose2(k)).x(), p.y(), p.theta()] for k in range(n)])


def with_false_loops(graph, share, seed=0):
    """The graph with `share` of its loops again between random poses; and which edges to trust."""
    rng = np.random.default_rng(seed)
    odometry = np.abs(graph.target - graph.source) == 1
    loops = np.flatnonzero(~odometry)
    k = int(share * len(loops))
    like = rng.choice(loops, k)
    source = rng.integers(0, len(graph), k)
    target = (source + rng.integers(2, len(graph) - 1, k)) % len(graph)
    false = PoseGraph(
        graph.pose,
        np.concatenate([graph.source, source]),
        np.concatenate([graph.target, target]),
        np.concatenate([graph.measurement, graph.measurement[like]]),
        np.concatenate([graph.information, graph.information[like]]),
    )
    return false, np.concatenate([odometry, np.zeros(k, bool)])


def row(path, repeats):
    graph = read_g2o(path)
    solution, ours = best_ms(lambda: solve(graph), repeats)
    cells = [path.stem, f"{len(graph):,}", f"{len(graph.source):,}", f"{ours:.1f}"]
    cells += [f"{solution.chi2:,.3f}", str(solution.iterations)]
    factors, values = gtsam_problem(graph)
    optimizer = gtsam.LevenbergMarquardtOptimizer
    from_file, plain = best_ms(lambda: optimizer(factors, values).optimize(), repeats)
    cells += [f"{plain:.1f}", f"{chi2(graph, gtsam_poses(from_file, len(graph))):,.3f}"]
    rough, _ = gtsam_problem(graph, diagonal=True)
    lago, started = best_ms(
        lambda: optimizer(factors, gtsam.lago.initialize(rough)).optimize(), repeats
    )
    cells += [f"{started:.1f}", f"{chi2(graph, gtsam_poses(lago, len(graph))):,.3f}"]
    return [*cells, f"{min(plain, started) / ours:.1f}"]


def further_row(path, repeats):
    """Robust solution among 20 % false loops, and covariances of many pairs."""
    graph = read_g2o(path)
    false, trusted = with_false_loops(graph, 0.2)
    robust, robust_ms = best_ms(lambda: solve_robust(false, trusted), 1)
    kept = robust.edge_weight > 0.5
    m = len(graph.source)
    solution = solve(graph)
    marginals, factor_ms = best_ms(lambda: Marginals.of(graph, solution), repeats)
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, len(graph), (2, 10_000))
    _, pairs_ms = best_ms(lambda: marginals.relative(a, b), 1)
    off = between(solution.pose[a], solution.pose[b]) - between(robust.pose[a], robust.pose[b])
    return [
        path.stem,
        f"{robust_ms:,.0f}",
        f"{kept[m:].sum()} of {len(kept) - m}",
        f"{(~kept[:m]).sum()} of {(~trusted[:m]).sum()}",
        f"{np.median(np.hypot(*off[:, :2].T)):.3f}",
        f"{factor_ms + pairs_ms:,.0f}",
    ]


def table(head, rows):
    width = [max(len(cell) for cell in column) for column in zip(head, *rows, strict=True)]
    for cells in (head, ["-" * w for w in width], *rows):
        print("  ".join(cell.rjust(w) for cell, w in zip(cells, width, strict=True)))
    print()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--robust", action="store_true", help="also with 20 %% false loops; slow")
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    head = ["graph", "poses", "edges", "ours ms", "χ²", "steps"]
    head += ["GTSAM ms", "χ²", "LAGO+GTSAM ms", "χ²", "times faster"]
    table(head, [row(path, arguments.repeats) for path in arguments.files])
    if not arguments.robust:
        return
    head = ["20 % false loops", "ms", "false kept", "true lost", "moved m", "10,000 covariances ms"]
    table(head, [further_row(path, arguments.repeats) for path in arguments.files])


if __name__ == "__main__":
    main()
