"""Odometry calibration and noise against the simulator's truth: python benchmarks/odometry.py

Runs in worlds of every kind, as drifted as they are and with a heading bias of 3° per metre on top.
Per row, over `--seeds` runs: position error after the best rigid fit, raw and calibrated, without
and with the bias (medians); estimate over truth of the noise: geometric mean, spread as a factor.

Then the share by which lengths are too long, at mid drift and with mild faults, by detectors that
err: what passes show of it less the truth, 1 sigma stated (median), what is left of it after the
correction, and all of it (rms).
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from topobatch.ingest.mapping import dead_reckoned
from topobatch.ingest.odometry.calibration import apply_calibration, calibrate
from topobatch.ingest.odometry.noise import estimate_noise
from topobatch.ingest.passes import fuse_passes
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import DRIFTS, FAULTS, ScenarioSettings
from topobatch.topology.run import Detections
from topobatch.topology.se2 import apply, fit_rigid

CONDITIONS = (("low", "none"), ("mid", "mild"), ("high", "mild"), ("high", "harsh"))
BIAS_DEG_PER_M = 3.0
WORLDS = ("maze", "organic", "office")


def farther(run, by_m=0.0, share=0.0):
    """The run with everything seen too far."""
    seen = run.detections
    away = np.hypot(*seen.centre.T)[:, None]
    centre = seen.centre * np.maximum(away * (1 + share) + by_m, 0) / np.maximum(away, 1e-6)
    return replace(run, detections=replace(seen, centre=centre))


def reported(run, inside):
    """The run with the detections whose measured centres are inside."""
    seen, rows = run.detections, np.flatnonzero(inside(run.detections.centre))
    kept = Detections(seen.time_ns[rows], seen.centre[rows], seen.branches.take(rows))
    return replace(run, detections=kept)


DETECTORS = {
    "as simulated": lambda run: run,
    "5 cm too near": lambda run: farther(run, by_m=-0.05),
    "5 cm too far": lambda run: farther(run, by_m=0.05),
    "10 cm too near": lambda run: farther(run, by_m=-0.1),
    "2 % too far": lambda run: farther(run, share=0.02),
    "5 % too near": lambda run: farther(run, share=-0.05),
    "within 0.8 m": lambda run: reported(run, lambda xy: np.hypot(*xy.T) < 0.8),
    "0.3 m ahead": lambda run: reported(run, lambda xy: xy[:, 0] > 0.3),
}


def rms_error(odometry, truth):
    """Rms position error [m] after the best rigid fit."""
    xy = odometry.at(truth.path_ns)[:, :2]
    T = fit_rigid(truth.path[:, :2], xy)
    return float(np.sqrt(np.mean(np.sum((apply(T, xy) - truth.path[:, :2]) ** 2, axis=1))))


def measured(world, drift, faults, junctions, seed):
    """(raw error, calibrated error, noise) of one simulated run."""
    scenario = simulate_scenario(
        ScenarioSettings(
            world, 1, junctions_per_run=junctions, drift=drift, faults=faults, seed=seed
        )
    )
    run, truth = scenario.runs["run1"], scenario.truth.runs["run1"]
    track = apply_calibration(run.odometry, calibrate(run.odometry, run.detections))
    noise = estimate_noise(track, run.detections, fuse_passes(track, run.detections))
    return rms_error(run.odometry, truth), rms_error(track, truth), noise


def true_noise(drift, faults):
    half = np.sqrt(0.5)
    return {
        "along": ("along_m_per_sqrt_m", drift.along_m_per_sqrt_m),
        "turn/√m": ("heading_rad_per_sqrt_m", np.radians(drift.heading_deg_per_sqrt_m)),
        "turn/√rad": ("heading_rad_per_sqrt_rad", np.radians(drift.heading_deg_per_sqrt_rad)),
        "centre": ("centre_m", faults.centre_m * half),
        "branch": ("branch_rad", np.radians(faults.branch_deg) * half),
    }


def row(world, level, fault_level, junctions, seeds):
    drift, faults = DRIFTS[level], FAULTS[fault_level]
    plain = [measured(world, drift, faults, junctions, seed) for seed in range(seeds)]
    biased = replace(drift, heading_bias_deg_per_m=BIAS_DEG_PER_M)
    bent = [measured(world, biased, faults, junctions, seed) for seed in range(seeds)]
    cells = [f"{world} {level} {fault_level}"]
    for runs in (plain, bent):
        cells += [f"{np.median([run[k] for run in runs]):.2f}" for k in (0, 1)]
    for name, truth in true_noise(drift, faults).values():
        ratio = np.log([getattr(run[2], name) / truth for run in plain])
        cells.append(f"{np.exp(ratio.mean()):.2f} (x {np.exp(ratio.std()):.2f})")
    return cells


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def lengths_told(junctions, seeds):
    """Rows of the second table."""
    runs = []
    for world in WORLDS:
        for seed in range(seeds):
            scenario = simulate_scenario(
                ScenarioSettings(
                    world, 1, junctions_per_run=junctions, drift="mid", faults="mild", seed=seed
                )
            )
            run, truth = scenario.runs["run1"], scenario.truth.runs["run1"]
            ways = [
                np.hypot(*np.diff(pose[:, :2], axis=0).T).sum()
                for pose in (truth.path, run.odometry.pose)
            ]
            runs.append((run, 1 - ways[0] / ways[1]))
    for name, seen_by in DETECTORS.items():
        told = [(dead_reckoned(seen_by(run))[3].motion, true) for run, true in runs]
        scales = [(motion.length_scale, true) for motion, true in told if motion is not None]
        yield [
            name,
            f"{rms([scale.estimate - true for scale, true in scales]):.4f}",
            f"{np.median([scale.sigma for scale, _ in scales]):.4f}",
            f"{rms([scale.applied - true for scale, true in scales]):.4f}",
            f"{rms([true for _, true in scales]):.4f}",
        ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--junctions", type=int, default=50)
    arguments = parser.parse_args()
    head = ["", "raw m", "cal. m", "3°/m: raw m", "cal. m"]
    head += list(true_noise(DRIFTS["low"], FAULTS["none"]))
    print("  ".join(f"{cell:>18}" if k == 0 else f"{cell:>11}" for k, cell in enumerate(head)))
    for world in WORLDS:
        for level, faults in CONDITIONS:
            cells = row(world, level, faults, arguments.junctions, arguments.seeds)
            print(
                "  ".join(
                    f"{cell:>18}" if k == 0 else f"{cell:>11}" for k, cell in enumerate(cells)
                ),
                flush=True,
            )
    print()
    for cells in (
        ["", "shown", "sigma", "left", "all"],
        *lengths_told(arguments.junctions, arguments.seeds),
    ):
        print("  ".join(f"{cell:>18}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
