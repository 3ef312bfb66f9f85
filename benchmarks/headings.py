"""Headings by scan matching.

    python benchmarks/headings.py FOLDER... [--real FOLDER...]

Folders as for `laser.py`. For all runs of a folder, and for all folders: share of heading errors
after 20 m within the 68.3, 95.4 and 99.7 % intervals of the run's noise, with standard errors for
independent stretches; stated over true standard deviation (root mean squares, pooled). Real logs
are compared with the consensus of all their scans (`revisits.py`).

For real logs also branches of junctions that were passed again: how often the headings of two
passes (rotated by that consensus) differ within the map's noise of a branch, and by how much. This
shows errors that passes do not share; `uncertainty.py --laser` covers shared ones in simulated
worlds. Missing folders are skipped.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from laser import ONE_PLACE_M, Log, Stretches, bent_onto, central, logs, true_passes
from numpy.typing import NDArray
from revisits import revisits

from topobatch.ingest.mapping import build_map
from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.junctions import no_passes
from topobatch.ingest.scans.keyframes import join
from topobatch.ingest.scans.matching import matched, posed
from topobatch.ingest.scans.noise import matched_noise
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections, Run
from topobatch.topology.se2 import wrap
from topobatch.topology.track import way_at

FloatArray = NDArray[np.float64]
LEVELS = (0.683, 0.954, 0.997)
FAR_M = 20.0
SAME_RAD = 0.35
"""Headings nearer than this are of one branch."""


@dataclass(frozen=True)
class Judged:
    """Of stretches: share of errors that the noise expects to be smaller, variance claimed and
    square of the error [rad²]; independent: how many do not overlap."""

    p: FloatArray
    claimed: FloatArray
    square: FloatArray
    independent: float


def judged(log: Log) -> Judged:
    """A run's headings, matched but without junctions."""
    parts = list(matched(posed(log.odometry, log.scans)))
    frames = join([part.keyframes for part in parts])
    pose = frames.body
    noise = matched_noise([part.spans for part in parts], no_passes())
    t = log.truth.time_ns
    t = t[(t >= frames.time_ns[0]) & (t <= frames.time_ns[-1])]
    ours = bent_onto(Odometry(frames.time_ns, pose, np.zeros(0, np.int64)), log, t)
    far = Stretches.of(log, t, ours, FAR_M)
    walk = noise.heading_rad_per_sqrt_m**2 * FAR_M
    walk = walk + noise.heading_rad_per_sqrt_rad**2 * far.turned
    return Judged(
        central(log, noise, t, ours)["all"],
        np.asarray(walk),
        far.error[:, 2] ** 2,
        float(way_at(log.truth, t)[-1]) / FAR_M,
    )


def branches_again(log: Log) -> str:
    """Differences of headings of one branch, each pass of a place against the one before it."""
    result = detect(log.odometry, log.scans)
    none = Detections(np.zeros(0, np.int64), np.zeros((0, 2)), Ragged.from_rows([]))
    run = Run(log.name, result.odometry, none, scanned=result.scanned)
    noise = build_map(run).fitted_noise
    assert noise is not None
    passes, (centre, turn) = result.scanned.passes, true_passes(log, result)
    pose = result.odometry.at(passes.time_ns)
    off = []
    for k in range(len(passes)):
        near = np.flatnonzero(np.hypot(*(centre[:k] - centre[k]).T) < ONE_PLACE_M)
        if len(near):
            one, other = (passes.branches[j] + pose[j, 2] + turn[j] for j in (k, int(near[-1])))
            apart = np.asarray(wrap(one[:, None] - other))
            nearest = np.take_along_axis(apart, np.abs(apart).argmin(axis=1)[:, None], axis=1)
            off += nearest[np.abs(nearest) < SAME_RAD].tolist()
    if not off:
        return "no branch was seen again"
    z = np.abs(off) / (np.sqrt(2) * noise.branch_rad)
    within = ", ".join(f"{np.mean(z < k):.3f}" for k in (1, 2, 3))
    return (
        f"branches seen again: {len(off)}, within 1, 2, 3 sigma {within}; differ by "
        f"{np.median(np.abs(off)) / 0.6745:.3f} rad (median), {np.std(off):.3f} (rms), where "
        f"{np.sqrt(2) * noise.branch_rad:.3f} is claimed"
    )


def told(name: str, runs: list[Judged]) -> None:
    """One line about some runs."""
    p = np.concatenate([run.p for run in runs])
    n = sum(run.independent for run in runs)
    shares = [float(np.mean(p < level)) for level in LEVELS]
    errors = [float(np.sqrt(level * (1 - level) / n)) for level in LEVELS]
    claimed = np.concatenate([run.claimed for run in runs]).mean()
    square = np.concatenate([run.square for run in runs]).mean()
    print(
        f"{name:24s} {len(runs):2d} runs, {n:4.0f} stretches: within "
        + ", ".join(f"{a:.3f} ({b:.3f})" for a, b in zip(shares, errors, strict=True))
        + f"; claimed / error {np.sqrt(claimed / square):.2f}"
        + f" ({1e3 * np.sqrt(square):.2f} mrad)",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--real", nargs="*", type=Path, default=[], help="logs without exact truth")
    options = parser.parse_args()
    every: list[Judged] = []
    for folder in options.folders:
        runs = [judged(log) for log in logs(folder)]
        told(folder.name, runs)
        every += runs
    if every:
        told("all", every)
    for folder in options.real:
        for recorded in logs(folder) if folder.is_dir() else ():
            seen = revisits(recorded.odometry, recorded.scans, recorded.truth)
            log = replace(recorded, truth=seen.path)
            told(f"{folder.name} {log.name}", [judged(log)])
            print(f"{'':24s} {branches_again(log)}", flush=True)


if __name__ == "__main__":
    main()
