"""Worlds with repeated parts, none of which were used to tune anything."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from topobatch.simulation.world import straight_world
from topobatch.simulation.worlds import make_world


def built(kind, seed, xy, pairs):
    """A world of straight corridors between points; of two in one line one is made."""
    return straight_world(f"{kind}-{seed}", kind, np.asarray(xy, np.float64), pairs)


def ends_of(world):
    return list(zip(world.source.tolist(), world.target.tolist(), strict=True))


def without_some(world, count, rng):
    """A world with so many corridors closed that closed a loop."""
    pairs = ends_of(world)
    for _ in range(count):
        order = rng.permutation(len(pairs)).tolist()
        at = next((k for k in order if _joined(len(world), pairs[:k] + pairs[k + 1 :])), None)
        if at is not None:
            del pairs[at]
    return built(world.kind, 0, world.xy, pairs)


def _joined(count, pairs):
    """Do the pairs join all of so many points?"""
    parts = DisjointSet(range(count))
    for u, v in pairs:
        parts.merge(u, v)
    return parts.n_subsets == 1


def moved(world, off_m, rng):
    """The same plan, every junction a little elsewhere (each coordinate to +- off_m)."""
    xy = world.xy + rng.uniform(-off_m, off_m, world.xy.shape)
    return built(world.kind, 0, xy, ends_of(world))


def star(arms, rings, seed, closed=0):
    """Streets from one middle, and rings that join them."""
    out = np.arange(1, rings + 1) * 7.0
    angle = np.arange(arms) * 2 * np.pi / arms
    rays = out[None] * np.exp(1j * angle)[:, None]
    z = np.concatenate([[0], rays.ravel()])
    number = 1 + np.arange(arms * rings).reshape(arms, rings)
    pairs = [(0, int(v)) for v in number[:, 0]]
    pairs += [pair for row in number.tolist() for pair in pairwise(row)]
    pairs += [
        (int(number[k, r]), int(number[(k + 1) % arms, r]))
        for k in range(arms)
        for r in range(rings)
    ]
    world = built("star", seed, np.column_stack([z.real, z.imag]), pairs)
    return without_some(world, closed, np.random.default_rng(seed))


def spiral(levels, seed):
    """A ramp whose levels lie over each other, each with the same exits; some exits have a door."""
    rng = np.random.default_rng(seed)
    steps = 8
    turn = np.arange(levels * steps) * 2 * np.pi / steps
    z = (12.0 + 0.02 * turn) * np.exp(1j * turn)
    xy, pairs = [*z], [*pairwise(range(len(z)))]
    for k in range(0, len(z), 2):
        xy.append(z[k] * 1.5)
        pairs.append((k, len(xy) - 1))
        if rng.random() < 0.5:
            xy.append(xy[-1] + 3j * z[k] / abs(z[k]))
            pairs.append((len(xy) - 2, len(xy) - 1))
    z = np.array(xy)
    return built("spiral", seed, np.column_stack([z.real, z.imag]), pairs)


def lattice(rows, columns, seed, *, closed=0.06, stubs=0.0, hexagonal=False):
    """Equal blocks, or equal hexagons, some corridors closed; ways that lead out at the border."""
    rng = np.random.default_rng(seed)
    number = np.arange(rows * columns).reshape(rows, columns)
    across = [(int(u), int(v)) for row in number for u, v in pairwise(row)]
    along = [
        (int(number[r, c]), int(number[r + 1, c]))
        for r in range(rows - 1)
        for c in range(columns)
        if not hexagonal or (r + c) % 2 == 0
    ]
    r, c = (part.ravel().astype(float) for part in np.indices((rows, columns)))
    if hexagonal:  # a brick wall, its bricks drawn as hexagons
        x, y = c * np.sqrt(3) / 2, 1.5 * r + 0.5 * ((r + c) % 2)
        xy = 5.0 * np.column_stack([x, y])
    else:
        xy = 6.0 * np.column_stack([c, r])
    pairs = [pair for pair in across + along if rng.random() > closed]
    middle = xy.mean(axis=0)
    points = [*xy]
    for v in np.unique(np.concatenate([number[0], number[-1], number[:, 0], number[:, -1]])):
        if rng.random() < stubs:
            out = np.array([0.0, np.sign(xy[v, 1] - middle[1])])
            if number[0, 0] <= v <= number[-1, -1] and v % columns in (0, columns - 1):
                out = np.array([np.sign(xy[v, 0] - middle[0]), 0.0])
            points.append(xy[v] + rng.uniform(2.0, 7.0) * out)
            pairs.append((int(v), len(points) - 1))
    return built("lattice", seed, points, pairs)


def doors(slots, seed, there=0.85):
    """A corridor with doors every 4.4 m on both sides, a few of them missing."""
    rng = np.random.default_rng(seed)
    xy = [(4.4 * k, 0.0) for k in range(slots)]
    pairs = list(pairwise(range(slots)))
    for k in range(slots):
        for side in (-1.0, 1.0):
            if rng.random() < there:
                xy.append((4.4 * k, 3.0 * side))
                pairs.append((k, len(xy) - 1))
    return built("doors", seed, xy, pairs)


def symmetric(seed, turns=4, image=False):
    """A part of a maze, built again turned round a hall in the middle, or once mirrored."""
    part = make_world("maze", 30, seed)
    z = part.xy[:, 0] + 1j * part.xy[:, 1]
    z = z - z.real.min() - 1j * z.imag.min() + (4 + 4j)
    gate = int(np.abs(z).argmin())
    turned = [z * np.exp(2j * np.pi * k / turns) for k in range(turns)]
    copies = [z, -z.conj()] if image else turned
    xy, pairs = [0j], []
    for copy in copies:
        first = len(xy)
        xy += copy.tolist()
        pairs += [(first + u, first + v) for u, v in ends_of(part)]
        pairs.append((0, first + gate))
    z = np.array(xy)
    return built("symmetric", seed, np.column_stack([z.real, z.imag]), pairs)


def with_block(block, seed):
    """A maze of its own around a standard block; and the block's vertices in it."""
    own = make_world("maze", 60, seed)
    shift = own.xy[own.xy[:, 0].argmax()] + np.array([5.0, 0.0]) - block.xy[block.xy[:, 0].argmin()]
    xy = np.concatenate([own.xy, block.xy + shift])
    pairs = ends_of(own) + [(u + len(own), v + len(own)) for u, v in ends_of(block)]
    pairs.append((int(own.xy[:, 0].argmax()), len(own) + int(block.xy[:, 0].argmin())))
    world = built("block", seed, xy, pairs)
    inside = np.flatnonzero(world.xy[:, 0] >= (block.xy + shift)[:, 0].min() - 0.1)
    return world, inside


def modular(seed, cells=9):
    """A random maze of equal cells: what repeats is all of its lengths."""
    rng = np.random.default_rng(seed)
    number = np.arange(cells * cells).reshape(cells, cells)
    walls = [(int(u), int(v)) for row in number for u, v in pairwise(row)]
    walls += [(int(u), int(v)) for row in number.T for u, v in pairwise(row)]
    parts, pairs = DisjointSet(range(cells * cells)), []
    for k in rng.permutation(len(walls)).tolist():
        if parts.merge(*walls[k]) or rng.random() < 0.25:
            pairs.append(walls[k])
    r, c = (part.ravel() for part in np.indices((cells, cells)))
    return built("cells", seed, 6.0 * np.column_stack([c, r]), pairs)
