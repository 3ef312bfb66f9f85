"""Maps as runs leave them, made without logs: parts of a world, seen with noise and faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from topobatch.simulation.chance import Chance
from topobatch.simulation.regions import grown
from topobatch.simulation.world import polyline_at, polyline_length
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import wrap
from topobatch.topology.topomap import RunNoise, TopoMap


@dataclass(frozen=True)
class Seeing:
    """How a run saw its part of the world (1 sigma, rates)."""

    centre_m: float = 0.05
    branch_rad: float = 0.05
    bend_m: float = 0.25
    """What is left of the drift after loop closure, smooth over tens of metres."""
    missed: float = 0.02
    branch_fault: float = 0.03


def observed_map(world, region, rng, name, seeing=Seeing()):
    """The map of a run that drove the corridors inside a region; `info["truth"]` names the world's
    vertex behind each of its own. A vertex that was missed joins the two corridors that go on
    straightest there."""
    drawn = Drawing(world, region, rng, seeing)
    return drawn.topomap(name)


class Drawing:
    """A world's part while it is turned into a map."""

    def __init__(self, world, region, rng, seeing):
        self.world, self.rng, self.seeing = world, rng, seeing
        inside = set(region)
        ends = list(zip(world.source.tolist(), world.target.tolist(), strict=True))
        # Pieces of way (vertex, vertex, polyline), to be joined where a vertex is missed.
        self.pieces = [
            (u, v, np.asarray(world.paths[e]))
            for e, (u, v) in enumerate(ends)
            if u in inside and v in inside and rng.random() > 0.04
        ]
        for v in sorted(inside):
            if rng.random() < seeing.missed:
                self._miss(v)
        self.vertices = sorted({w for u, v, _ in self.pieces for w in (u, v)})
        self.turn = rng.uniform(-np.pi, np.pi)
        self.shift = rng.uniform(-30, 30, 2)
        # A few waves of 60 to 150 m in random directions, for each coordinate.
        away = rng.uniform(-np.pi, np.pi, (4, 2))
        waves = np.stack([np.cos(away), np.sin(away)]) * 2 * np.pi / rng.uniform(60, 150, (4, 2))
        self.waves = waves, rng.uniform(0, 2 * np.pi, (4, 2)), rng.normal(size=(4, 2))

    def _miss(self, v):
        at = [k for k, (a, b, _) in enumerate(self.pieces) if (a == v) != (b == v)]
        if len(at) < 2:
            return
        legs = [self._from(v, self.pieces[k]) for k in at]
        out = [np.arctan2(*(polyline_at(p, np.array([0.7]))[0] - p[0])[::-1]) for _, p in legs]
        gap = np.abs(wrap(np.subtract.outer(out, out)))
        i, j = np.unravel_index(gap.argmax(), gap.shape)
        (u, p), (w, q) = legs[i], legs[j]
        if u == w:
            return
        kept = [x for k, x in enumerate(self.pieces) if k not in at]
        self.pieces = [*kept, (u, w, np.concatenate([p[::-1], q[1:]]))]

    def _from(self, v, piece):
        a, b, path = piece
        return (b, path) if a == v else (a, path[::-1])

    def moved(self, points):
        """World points in the map's frame: bent by drift, turned, shifted."""
        frequency, phase, size = self.waves
        angle = np.einsum("pk,kmc->pmc", points, frequency) + phase
        bend = self.seeing.bend_m * np.einsum("pmc,mc->pc", np.sin(angle), size) / 2
        c, s = np.cos(self.turn), np.sin(self.turn)
        return (points + bend) @ np.array([[c, s], [-s, c]]) + self.shift

    def topomap(self, name):
        number = {v: k for k, v in enumerate(self.vertices)}
        looks = 1 + self.rng.poisson(1.5, len(number))
        noise = self.rng.normal(size=(len(number), 2)) * self.seeing.centre_m
        xy = self.moved(self.world.xy[self.vertices]) + noise / np.sqrt(looks)[:, None]
        rows = [self._branches(v, looks[k]) for k, v in enumerate(self.vertices)]
        ends = [(number[u], number[v]) for u, v, _ in self.pieces]
        paths, used = [], []
        for (i, j), (_, _, path) in zip(ends, self.pieces, strict=True):
            line = self.moved(path)
            share = np.linspace(0, 1, len(line))[:, None]
            line = line + (1 - share) * (xy[i] - line[0]) + share * (xy[j] - line[-1])
            paths.append(line)
            used.append((_nearest(rows[i], line), _nearest(rows[j], line[::-1])))
        length = np.array([polyline_length(p) for p in paths])
        seen = np.repeat(np.arange(len(looks)), looks)
        return TopoMap(
            run=name,
            frame="odom",
            xy=xy,
            branches=Ragged.from_rows(rows),
            kind=tuple("dead_end" if len(r) == 1 else "junction" for r in rows),
            source=np.array([i for i, _ in ends], np.int64),
            target=np.array([j for _, j in ends], np.int64),
            source_branch=np.array([s for s, _ in used], np.int64),
            target_branch=np.array([t for _, t in used], np.int64),
            length=length,
            length_sigma=0.05 + 0.01 * length,
            traversals=1 + self.rng.poisson(0.7, len(ends)),
            paths=tuple(paths),
            observation_vertex=seen,
            observation_time_ns=np.arange(len(seen)) * 10**9,
            noise=RunNoise(centre_m=self.seeing.centre_m, branch_rad=self.seeing.branch_rad),
            info={"truth": self.vertices},
        )

    def _branches(self, v, looks):
        """The headings seen at a vertex: noise, and now and then one too few or too many."""
        row = self.world.branches[v] + self.turn
        row = row + self.rng.normal(size=len(row)) * self.seeing.branch_rad / np.sqrt(looks)
        if self.rng.random() < self.seeing.branch_fault / looks + 0.01:
            if len(row) > 1 and self.rng.random() < 0.6:
                row = np.delete(row, self.rng.integers(len(row)))
            else:
                row = np.append(row, self.rng.uniform(-np.pi, np.pi))
        return np.sort(wrap(row))


def _nearest(row, line):
    """The branch by which a path leaves, -1 if none points that way."""
    out = polyline_at(line, np.array([0.7]))[0] - line[0]
    gap = np.abs(wrap(row - np.arctan2(out[1], out[0])))
    return int(gap.argmin()) if gap.min() < 0.6 else -1


def scattered_regions(world, runs, size, chance):
    """Discs of vertices, centred where few regions are yet; the overlap is not controlled."""
    load = np.zeros(len(world))
    regions = []
    for _ in range(runs):
        options = chance.order(len(world))[:12]
        centre = int(options[np.argmin(load[options])])
        away = np.hypot(*(world.xy - world.xy[centre]).T)
        wanted = round(size * chance.one_uniform(0.8, 1.2))
        region = grown(world, {centre}, wanted, away, set())
        load[sorted(region)] += 1
        regions.append(region)
    return regions


def scattered_maps(world, count, size, seed, seeing=Seeing()):
    """Maps of runs scattered over one world, each with the set of world vertices that it saw."""
    rng = np.random.default_rng(seed)
    regions = scattered_regions(world, count, size, Chance("calibration", seed))
    maps = [observed_map(world, r, rng, f"r{k:02d}", seeing) for k, r in enumerate(regions)]
    return [(m, set(m.info["truth"])) for m in maps]
