"""Odometry calibration and noise against the simulator's truth: python benchmarks/odometry.py

Runs in worlds of every kind, as drifted as they are and with a heading bias of 3° per metre on top.
Per row, over `--seeds` runs: position error after the best rigid fit, raw and calibrated, without
and with the bias (medians); estimate over truth of the noise: geometric mean, spread as a factor.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from topobatch.ingest.odometry.calibration import apply_calibration, calibrate
from topobatch.ingest.odometry.noise import estimate_noise
from topobatch.ingest.passes import fuse_passes
from topobatch.simulation import DRIFTS, FAULTS, ScenarioSettings, simulate_scenario
from topobatch.topology.se2 import apply, fit_rigid

CONDITIONS = (("low", "none"), ("mid", "mild"), ("high", "mild"), ("high", "harsh"))
BIAS_DEG_PER_M = 3.0


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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--junctions", type=int, default=50)
    arguments = parser.parse_args()
    head = ["", "raw m", "cal. m", "3°/m: raw m", "cal. m"]
    head += list(true_noise(DRIFTS["low"], FAULTS["none"]))
    print("  ".join(f"{cell:>18}" if k == 0 else f"{cell:>11}" for k, cell in enumerate(head)))
    for world in ("maze", "organic", "office"):
        for level, faults in CONDITIONS:
            cells = row(world, level, faults, arguments.junctions, arguments.seeds)
            print(
                "  ".join(
                    f"{cell:>18}" if k == 0 else f"{cell:>11}" for k, cell in enumerate(cells)
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
