"""The pose graph on public graphs, beside GTSAM: python benchmarks/posegraph.py FILE.g2o…

    OMP_NUM_THREADS=1 python benchmarks/posegraph.py graphs/*.g2o

GTSAM comes with the tools of the tests. Files: intel, CSAIL, MIT, manhattan (M3500) and others, for
instance from github.com/david-m-rosen/SE-Sync.

Times are the best process CPU times of one thread, ours from arrays to convergence (ordering,
Gauss–Newton), GTSAM's for `optimize()` alone, without building its graph; both begin from the poses
of the file, or from chained edges where it has none, as the product begins from dead reckoning. χ²
is g2o's metric for both; GTSAM minimises another residual (the logarithm of the error), so that its
minimum may score higher. A χ² far above the other one is a local minimum. `LAGO` is GTSAM's own
start for planar graphs, its time included.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import gtsam
import numpy as np
from public_graphs import read_g2o

from topobatch.topology.posegraph.graph import edge_errors, squared
from topobatch.topology.posegraph.marginals import Marginals
from topobatch.topology.posegraph.solve import solve


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
    cells.append(f"{min(plain, started) / ours:.1f}")
    return [*cells, f"{covariances_ms(graph, solution, repeats):,.0f}"]


def covariances_ms(graph, solution, repeats):
    """Time of 10,000 covariances between random poses, the factorisation included."""
    marginals, factor_ms = best_ms(lambda: Marginals.of(graph, solution), repeats)
    a, b = np.random.default_rng(0).integers(0, len(graph), (2, 10_000))
    return factor_ms + best_ms(lambda: marginals.relative(a, b), 1)[1]


def table(head, rows):
    width = [max(len(cell) for cell in column) for column in zip(head, *rows, strict=True)]
    for cells in (head, ["-" * w for w in width], *rows):
        print("  ".join(cell.rjust(w) for cell, w in zip(cells, width, strict=True)))
    print()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    head = ["graph", "poses", "edges", "ours ms", "χ²", "steps"]
    head += ["GTSAM ms", "χ²", "LAGO+GTSAM ms", "χ²", "times faster"]
    head.append("10,000 covariances ms")
    table(head, [row(path, arguments.repeats) for path in arguments.files])


if __name__ == "__main__":
    main()
