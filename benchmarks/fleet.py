"""Fleets: python benchmarks/fleet.py [--sizes 200,400,1000]"""

from __future__ import annotations

import numpy as np
from observed import observed_map

from topobatch.simulation import make_world
from topobatch.simulation.chance import Chance
from topobatch.simulation.regions import scattered_regions

KINDS = ("maze", "office", "organic", "city")


def fleet_of(count, *, per_site=10, world=200, size=50, first=0):
    """`count` maps of runs in sites of four kinds, each with (site, world vertices that it saw).

    A site is a world of so many junctions; its runs drove parts of about `size` of them.
    """
    out = []
    for site in range(-(-count // per_site)):
        seed = first + site
        building = make_world(KINDS[site % len(KINDS)], world, seed)
        rng = np.random.default_rng(seed)
        regions = scattered_regions(building, per_site, size, Chance("fleet", seed))
        for k, region in enumerate(regions):
            topomap = observed_map(building, region, rng, f"s{site:04d}-{k:02d}")
            out.append((topomap, (site, frozenset(topomap.info["truth"]))))
    return out[:count]
