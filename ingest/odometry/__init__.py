"""From raw poses to a reliable odometry: sanity checks, jumps, calibration, noise."""
