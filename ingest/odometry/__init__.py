"""From raw poses to an odometry that can be relied on: sanity, jumps, calibration, noise."""
