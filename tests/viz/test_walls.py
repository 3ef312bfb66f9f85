from dataclasses import replace

import numpy as np

from topobatch.merge.result import site_views
from topobatch.topology.se2 import apply, compose, inverse
from topobatch.topology.views import CELL_M
from topobatch.viz.walls import walls_of

from ..topology.floors import CELL_M as TRUE_M
from ..topology.floors import floor, views_at

FLOOR = floor(1)
ROUND = np.array([(18.0, 18.0, 0.0), (26.0, 18.0, 0.4), (26.0, 26.0, -1.0), (18.0, 26.0, 2.0)])
"""Poses of views, not along the axes of the floor."""


def centres(cells, grid):
    row, column = np.nonzero(cells)
    own = (np.column_stack([column, row]) + 0.5) * grid.resolution_m
    return apply(np.array(grid.origin), own)


def wrong(grid, T_floor_grid=(0.0, 0.0, 0.0)) -> tuple[float, float]:
    """Share of cells shown as walls that no true wall is near, and of free ones that are walls."""
    near = int(np.ceil(CELL_M / TRUE_M)) + 1

    def at(cells, around):
        x, y = np.floor(apply(np.array(T_floor_grid), centres(cells, grid)) / TRUE_M).T.astype(int)
        padded = np.pad(FLOOR, near)
        found = [
            padded[y + near + dy, x + near + dx]
            for dy in range(-around, around + 1)
            for dx in range(-around, around + 1)
        ]
        return np.array(found)

    wall = ~grid.free & ~grid.unknown
    assert wall.sum() > 500
    return 1 - at(wall, near).any(axis=0).mean(), at(grid.free, 0).mean()


def test_views_laid_over_each_other_show_the_walls() -> None:
    grid = walls_of([views_at(FLOOR, ROUND)], "map")
    assert grid.frame == "map"
    assert max(wrong(grid)) < 0.01
    known = ~grid.unknown
    assert known[[0, -1]].any(axis=1).all()
    assert known[:, [0, -1]].any(axis=0).all()  # nothing but what is known


def test_runs_of_a_site_show_its_walls_in_one_frame(merge_of) -> None:
    """Each run's views are posed in a frame of its own."""
    result, maps = merge_of([["a", "b"]])
    (component,) = result.components
    T_floor_site = np.array([16.0, 18.0, 0.0])
    seen = {}
    for m, pose in zip(maps, (ROUND[:2], ROUND[2:]), strict=True):
        T_run_floor = inverse(compose(T_floor_site, component.poses[m.run]))
        views = views_at(FLOOR, pose)
        seen[m.run] = replace(m, views=replace(views, pose=compose(T_run_floor, pose)))
    grid = walls_of(site_views(result.fused, component, seen), "site")
    assert max(wrong(grid, T_floor_site)) < 0.01
    one = walls_of(site_views(result.fused, component, {"a": seen["a"]}), "site")
    assert (~one.unknown).sum() < (~grid.unknown).sum()
