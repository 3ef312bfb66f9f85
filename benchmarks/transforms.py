"""Contributions to the stated errors of merges.

    python benchmarks/transforms.py [--seeds 1]

Runs of one simulated world are matched by the truth and fused, so that results do not depend on
matching. For the position of one map's centre relative to another (along the line between both
centres, and across it), and for the relative rotation:

  within     how often the truth lies within the 68.3 and 95 % intervals
  carried    the maps' own errors (samples of their posteriors) propagated through the joint pose
             graph, over what the merge states (mean variances)
  legs, centres, branches, grid, scale
             shares of the stated variance by the odometry between places, by observations of
             centres and branches, by the grid of a building, and by the scale of lengths

Worlds, errors and seeds as in `uncertainty.py`. Uses dense algebra: for maps of about 40 junctions.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from itertools import combinations, product

import numpy as np
from scipy.stats import chi2
from uncertainty import SHARES, placing_error, scenario_of

from topobatch.ingest.mapping import build_map_with_errors
from topobatch.merge.fusion.joint_graph import (
    branch_headings,
    fitted_poses,
    optimise_poses,
    pass_counts,
    run_poses,
)
from topobatch.merge.fusion.uncertainty import Landmarks
from topobatch.merge.fusion.vertex_partition import Pool, matched_groups
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.simulation.settings import DRIFTS, FAULTS
from topobatch.simulation.truth import true_vertex_of_nodes
from topobatch.topology.posegraph.graph import edge_errors
from topobatch.topology.se2 import apply, between, fit_rigid, wrap

QUANTITIES = ("along", "across", "turn")
PARTS = ("legs", "centres", "branches", "grid", "scale")
KINDS = ("maze", "office", "organic", "city", "tiles")
LEAST_SHARED = 5
STEP = 1e-6
"""Of the differences that stand for derivatives."""


def by_the_truth(maps, labels):
    """Verdicts that match what two runs both saw, each once."""
    verdicts = []
    for a, b in combinations(maps, 2):
        once = []
        for label in (labels[a.run], labels[b.run]):
            vertex, row, count = np.unique(label, return_index=True, return_counts=True)
            keep = (vertex >= 0) & (count == 1)
            once.append(dict(zip(vertex[keep].tolist(), row[keep].tolist(), strict=True)))
        matched = np.array([(once[0][v], once[1][v]) for v in sorted({*once[0]} & {*once[1]})])
        if len(matched) >= LEAST_SHARED:
            T_a_b = fit_rigid(a.xy[matched[:, 0]], b.xy[matched[:, 1]])
            best = Alignment(T_a_b, 50.0, matched, 0.0)
            verdicts.append(PairVerdict(a.run, b.run, Verdict.MERGED, True, 50.0, "", best=best))
    return verdicts


class Linear:
    """A pose graph at its solution: derivatives J of its errors by poses and shared errors, their
    information, and the inverse of the normal matrix with the first pose held."""

    def __init__(self, graph, solution):
        n, k = len(graph.pose), len(graph.shared)
        x = np.concatenate([solution.pose.ravel(), solution.shared])

        def errors(at):
            return edge_errors(graph, at[: 3 * n].reshape(n, 3), at[3 * n :]).ravel()

        steps = STEP * np.eye(len(x))
        self.J = np.stack([errors(x + d) - errors(x - d) for d in steps], axis=1) / (2 * STEP)
        self.information = graph.information * solution.edge_weight[:, None, None]
        blocks = self.J.reshape(-1, 3, len(x))
        self.weighed = (self.information @ blocks).reshape(self.J.shape)
        self.known = np.zeros(len(x))
        headings = 3 * graph.priors.node + 2
        weight = graph.priors.information[:, 2, 2] * solution.prior_weight
        np.add.at(self.known, headings, weight)
        self.known[3 * n :] = graph.shared.sigma**-2.0 if k else 0.0
        normal = self.J.T @ self.weighed + np.diag(self.known + 1e-9)
        self.inverse = np.zeros_like(normal)
        self.inverse[3:, 3:] = np.linalg.inv(normal[3:, 3:])


def functionals(pool, xy, node, pair, size):
    """(3, size) along, across and turn of the second run of a pair seen from the first, as sums
    over the poses of rows; (2, 2) the two axes."""
    fits, middles = [], []
    for run in pair:
        rows = np.flatnonzero(pool.run == run)
        arm = xy[rows] - xy[rows].mean(axis=0)
        fit, at = np.zeros((3, size)), 3 * node[rows]
        for axis in (0, 1):
            np.add.at(fit[axis], at + axis, 1 / len(rows))
            lever = (-arm[:, 1], arm[:, 0])[axis] / (arm**2).sum()
            np.add.at(fit[2], at + axis, lever)
        fits.append(fit)
        middles.append(xy[rows].mean(axis=0))
    (a, b), line = fits, middles[1] - middles[0]
    far = np.hypot(*line)
    unit = line / far
    aside = np.array([-unit[1], unit[0]])
    step = b[:2] - a[:2]
    return np.stack([unit @ step, aside @ step - far * a[2], b[2] - a[2]]), np.stack([unit, aside])


def stated(pool, joint, of_marks, pair):
    """(3,) variances that a merge states, and their parts (5, 3)."""
    (marks, linear), n = of_marks, len(pool)
    xy, poses = joint.solution.pose[:, :2], 3 * len(marks.graph.pose)
    what, _ = functionals(pool, xy, marks.node, pair, len(linear.J.T))
    y = what @ linear.inverse
    e = (linear.J @ y.T).reshape(-1, 3, 3)
    part = np.einsum("eik,eij,ejk->ek", e, linear.information, e)
    read = e[:, 2] ** 2 * linear.information[:, 2, 2, None]
    legs = marks.graph.target < n
    own = functionals(pool, xy, np.arange(n), pair, 3 * n)[0].reshape(3, n, 3)[:, :, :2]
    alone = (own**2).sum(axis=2) @ marks.seen**2
    known = y**2 * linear.known
    parts = np.stack(
        [
            part[legs].sum(axis=0),
            (part - read)[~legs].sum(axis=0) + alone,
            read[~legs].sum(axis=0),
            known[:, :poses].sum(axis=1),
            known[:, poses:].sum(axis=1),
        ]
    )
    return np.einsum("ki,ki->k", y, what) + alone, parts


def carried(pool, joint, linear, errors, pair):
    """(3,) variances by what maps state of their errors, through the joint graph."""
    graph, n = joint.graph, len(pool)
    xy = joint.solution.pose[:, :2]
    y = functionals(pool, xy, np.arange(n), pair, len(linear.J.T))[0] @ linear.inverse
    within = np.repeat(pool.run[graph.source] == pool.run[graph.target], 3)
    gain = y @ (linear.J[within, : 3 * n].T @ linear.weighed[within]).T
    out = np.zeros(3)
    for run, m in enumerate(pool.maps):
        rows = np.flatnonzero(pool.run == run)
        axes = turned(fit_rigid(xy[rows], m.xy)[2])
        sample = errors[m.run].sample.copy()
        sample[:, :2] = np.einsum("ij,njs->nis", axes, sample[:, :2])
        of = (3 * rows[:, None] + np.arange(3)).ravel()
        out += ((gain[:, of] @ sample.reshape(len(of), -1)) ** 2).mean(axis=1)
    # Ties turn by how branches were read, and grids by themselves.
    count = np.maximum(np.isfinite(branch_headings(pool)).sum(axis=1), 1) * pass_counts(pool)
    read = np.array([m.measured.branch_rad for m in pool.maps])[pool.run] ** 2 / count
    pull = np.zeros((3, n))
    for e in np.flatnonzero(~within[::3]).tolist():
        by = y @ linear.weighed[3 * e + 2]
        pull[:, graph.target[e]] += by
        pull[:, graph.source[e]] -= by
    held = linear.known[: 3 * n]
    return out + pull**2 @ read + y[:, : 3 * n] ** 2 @ held


def found(truth, maps, labels, poses):
    """(2,) [m] and [rad] by which the second of two maps is misplaced, seen from the first, in the
    component's frame; None where it is no merge of these two."""
    a, b = maps
    if placing_error(truth, a, b, labels, poses) is None:
        return None
    T_world = []
    for m in maps:
        known = labels[m.run] >= 0
        world = truth.worlds[truth.runs[m.run].world]
        T_world.append(fit_rigid(world.xy[labels[m.run][known]], m.xy[known]))
    T, T_true = between(poses[a.run], poses[b.run]), between(*T_world)
    middle = b.xy.mean(axis=0)
    off = apply(T, middle) - apply(T_true, middle)
    return turned(poses[a.run][2]) @ off, wrap(T[2] - T_true[2])


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def judged(scenario):
    """Of every tied pair: (3,) squared errors over stated variances, carried over stated, and the
    shares (5, 3) of the parts."""
    built = [build_map_with_errors(run) for _, run in sorted(scenario.runs.items())]
    errors = {m.run: e for m, e in built if m.pieces == 1}
    maps = [m for m, _ in built if m.pieces == 1]
    labels = {m.run: true_vertex_of_nodes(scenario.truth, m) for m in maps}
    verdicts = by_the_truth(maps, labels)
    tied = {run for v in verdicts for run in (v.a, v.b)}
    if len(tied) < len(maps) or len(maps) < 2:
        return
    pool = Pool.of(maps)
    label = matched_groups(pool, verdicts).labels()
    joint = optimise_poses(pool, label, run_poses(list(pool.first), verdicts))
    poses, names = fitted_poses(pool, joint.pose), [m.run for m in maps]
    marks = Landmarks.of(pool, label, joint.graph, joint.solution)
    marks = marks, Linear(marks.graph, marks.solution)
    linear = Linear(joint.graph, joint.solution.with_full_weights())
    for v in verdicts:
        pair = names.index(v.a), names.index(v.b)
        xy = joint.solution.pose[:, :2]
        # Poses of runs stand in the frame of the component, the solution in one of its own.
        turn = fit_rigid(joint.pose[:, :2], xy)[2]
        axes = functionals(pool, xy, np.arange(len(pool)), pair, 3 * len(pool))[1]
        off = found(scenario.truth, [maps[k] for k in pair], labels, poses)
        if off is not None:
            error = np.append(axes @ turned(turn).T @ off[0], off[1])
            variance, parts = stated(pool, joint, marks, pair)
            yield (
                error**2 / variance,
                carried(pool, joint, linear, errors, pair) / variance,
                parts / variance,
            )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--worlds", nargs="+", default=["maze", "office", "organic", "city", "tiles"]
    )
    parser.add_argument("--drifts", nargs="+", default=list(DRIFTS))
    parser.add_argument("--faults", nargs="+", default=list(FAULTS))
    parser.add_argument("--seeds", type=int, default=1, help="scenarios per world, drift, faults")
    parser.add_argument("--first", type=int, default=2001, help="first seed")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    rows = defaultdict(list)
    for world, drift, faults, seed in product(args.worlds, args.drifts, args.faults, seeds):
        scenario, _ = scenario_of((world, drift, faults, seed, 3, 40, False))
        if scenario is not None:
            rows[drift] += judged(scenario)
    print(f"{'':14}{'pairs':>6}{'within 68.3 95':>16}{'carried':>9}", *map("{:>9}".format, PARTS))
    for drift in args.drifts:
        z2, over, parts = (np.array(of) for of in zip(*rows[drift], strict=True))
        for k, name in enumerate(QUANTITIES):
            within = [100 * np.mean(z2[:, k] <= chi2.ppf(p, 1)) for p in SHARES[:2]]
            shares = "".join(f"{x:10.2f}" for x in parts[:, :, k].mean(axis=0))
            print(
                f"{drift:6}{name:8}{len(z2):6}{within[0]:11.0f}{within[1]:5.0f}"
                f"{over[:, k].mean():9.2f}{shares}"
            )


if __name__ == "__main__":
    main()
