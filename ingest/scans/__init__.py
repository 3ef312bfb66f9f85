"""Junctions from range sensors: scan matching, windowed occupancy grids, skeletons."""
