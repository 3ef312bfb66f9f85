"""Junctions from the range sensors people record: scan matching, windowed grids, skeletons."""
