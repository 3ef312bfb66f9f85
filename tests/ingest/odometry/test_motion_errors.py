"""Errors of lengths and of the detector's point, made and shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.ingest.odometry.calibration import MotionErrors
from topobatch.ingest.odometry.motion_errors import describe_scale, motion_errors, refine_scale
from topobatch.ingest.odometry.noise import estimate_noise
from topobatch.ingest.passes import fuse_passes
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.topology.odometry import Odometry
from topobatch.topology.run import Detections, Run
from topobatch.topology.topomap import RunNoise

USUAL = RunNoise()


def simulated(world: str, drift: str, faults: str, seed: int) -> tuple[Run, RunNoise]:
    """A run, and its noise as estimated from it."""
    settings = ScenarioSettings(
        world, 1, junctions_per_run=60, drift=drift, faults=faults, seed=seed
    )
    run = simulate_scenario(settings).runs["run1"]
    passes = fuse_passes(run.odometry, run.detections)
    return run, estimate_noise(run.odometry, run.detections, passes)


def drifting(noise: RunNoise, times: float) -> RunNoise:
    """The noise with headings that drift so many times as much as usual."""
    return replace(
        noise,
        heading_rad_per_sqrt_m=times * USUAL.heading_rad_per_sqrt_m,
        heading_rad_per_sqrt_rad=times * USUAL.heading_rad_per_sqrt_rad,
    )


def scaled(odometry: Odometry, factor: float) -> Odometry:
    """The track with all lengths too long by a factor."""
    return replace(odometry, pose=odometry.pose * [factor, factor, 1.0])


def test_passes_show_the_scale_and_what_of_it_is_likely_is_taken_off() -> None:
    run, noise = simulated("maze", "low", "none", 5)

    def found(factor: float, detections: Detections = run.detections) -> MotionErrors | None:
        """Of an odometry whose lengths are too long by a factor."""
        track, told = scaled(run.odometry, factor), drifting(noise, 3.0)
        return motion_errors(track, detections, fuse_passes(track, detections), told)

    for factor in (0.92, 0.95, 0.97, 1.0, 1.03, 1.05, 1.08):
        errors = found(factor)
        assert errors is not None
        scale = errors.length_scale
        assert abs(scale.estimate - (1 - 1 / factor)) < 2 * scale.sigma
        assert 0.01 < scale.sigma < 0.012
        # An exact odometry is not made worse by the noise of passes; a bad one is corrected.
        if factor != 1.0:
            assert 0.6 < scale.applied / scale.estimate < 1.0
        else:
            assert abs(scale.applied) < 0.002
        assert errors.lever_x_m.applied == errors.lever_y_m.applied == 0.0
    # No odometry errs by half: then the detector does, or its unit is another one.
    seen, track = run.detections, run.odometry
    feet = Detections(seen.time_ns, 3.28 * seen.centre, seen.branches)
    errors = found(1.0, feet)
    assert errors is not None
    assert errors.length_scale.applied == 0.0
    (told,) = describe_scale(errors)
    assert "nothing is corrected" in told
    passes = fuse_passes(track, feet)
    assert refine_scale(track, feet, passes, noise) > 0.2
    few = Detections(seen.time_ns[:3], seen.centre[:3], seen.branches.take(np.arange(3)))
    assert found(1.0, few) is None
    # Nothing is corrected where hardly anything is known.
    for along in (10.0, 1e8):
        vague = replace(noise, along_m_per_sqrt_m=along)
        errors = motion_errors(track, seen, fuse_passes(track, seen), vague)
        assert errors is not None
        assert abs(errors.length_scale.applied) < 0.002
