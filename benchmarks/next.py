"""Whether the drive that `topobatch next` proposes first joins sites.

python benchmarks/next.py [--cases N] [--first SEED] [--spare N]

Teams of robots in one world, of little overlap, whose runs make several sites where the truth has
one. The first proposal is driven by the simulator and merged with the rest: the number of sites
falls, or does not. Beside it a drive of the same length along random corridors, from a random
junction that some run knows. Where the map leads nowhere, as its placement is wrong, the driver
stops. False: merges of the new run to a place it was not at.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass

import numpy as np

from topobatch.ingest.mapping import build_map
from topobatch.merge import drives as planning
from topobatch.merge.drive import Drive
from topobatch.merge.merging import merge_maps
from topobatch.merge.pieces import joined_pieces
from topobatch.merge.result import MergeResult
from topobatch.simulation.chance import Chance
from topobatch.simulation.scenario import Scenario, simulate_run, simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.truth import Truth, true_vertex_of_nodes
from topobatch.simulation.walk import Leg
from topobatch.topology.errors import UsageError
from topobatch.topology.se2 import fit_rigid, wrap

KINDS = ("maze", "office", "organic", "city")
OVERLAPS = (0.1, 0.15, 0.2, 0.3)
RUNS, JUNCTIONS = 4, 25
TURN_RAD = 0.7
"""A driver takes a corridor for the one that the plan names within this angle, as drawings do."""


@dataclass
class Team:
    scenario: Scenario
    maps: list
    result: MergeResult
    vertex: dict

    @property
    def world(self):
        return next(iter(self.scenario.worlds.values()))

    def place(self, node):
        """World vertices that a fused vertex is, the most frequent first."""
        members = self.result.fused.members[node]
        seen = Counter(int(self.vertex[run][v]) for run, own in members.items() for v in own)
        return [v for v, _ in seen.most_common() if v >= 0]

    def turn(self, component):
        """The heading of a component's frame in the world."""
        fused, pairs = self.result.fused, []
        for node in np.flatnonzero(fused.component == component).tolist():
            pairs += [(node, v) for v in self.place(node)[:1]]
        nodes, vertices = np.array(pairs).T
        return float(fit_rigid(self.world.xy[vertices], fused.xy[nodes])[2])


def team(kind, overlap, seed):
    settings = ScenarioSettings(
        kind, runs=RUNS, overlap=overlap, junctions_per_run=JUNCTIONS, drift="mid", seed=seed
    )
    scenario = simulate_scenario(settings)
    maps = [m for run in scenario.runs.values() for m in joined_pieces(build_map(run))]
    vertex = {
        m.run: true_vertex_of_nodes(scenario.truth, m) for m in maps if m.run in scenario.runs
    }
    return Team(scenario, maps, merge_maps(maps), vertex)


def way(world, start, goal, most_m):
    """Legs of the shortest way between two vertices, none if it is longer than `most_m`."""
    best, came, front = {start: 0.0}, {}, {start}
    while front:
        here = min(front, key=lambda v: (best[v], v))
        front.remove(here)
        if here == goal:
            break
        for edge, other, _ in world.ends(here):
            new = best[here] + float(world.length[edge])
            if new < best.get(other, most_m):
                best[other], came[other] = new, Leg(edge, here, other)
                front.add(other)
    if goal not in came:
        return []
    legs = []
    while goal != start:
        legs.append(came[goal])
        goal = came[goal].source
    return legs[::-1]


def straight_on(world, here, heading, most_m, chance=None):
    """Legs from a vertex, always by the branch nearest to straight on, or by a random one, never
    back, for at most `most_m`."""
    legs, driven = [], 0.0
    while driven < most_m:
        ends = world.ends(here)
        if legs and len(ends) > 1:
            ends = [end for end in ends if end[0] != legs[-1].edge]
        turns = [abs(float(wrap(h - heading))) for _, _, h in ends]
        k = int(np.argmin(turns)) if chance is None else chance.index(len(ends))
        if chance is None and not legs and turns[k] > TURN_RAD:
            break
        edge, other, _ = ends[k]
        heading = next(h + np.pi for e, _, h in world.ends(other) if e == edge)
        legs.append(Leg(edge, here, other))
        driven += float(world.length[edge])
        here = other
    return legs


def driven(team, drive: Drive):
    """The legs of a drive in the world, as far as it leads where it says."""
    world, legs = team.world, []
    here = next(iter(team.place(drive.stops[0].junction)), None)
    if here is None:
        return []
    last = drive.stops[0]
    for after in drive.stops[1:]:
        if after.junction is None:
            heading = drive.heading_rad + team.turn(drive.component)
            legs += straight_on(world, here, heading, drive.length_m - drive.known_m)
            break
        planned_m = float(np.hypot(*np.subtract(after.xy, last.xy)))
        places = team.place(after.junction)
        found = [way(world, here, v, 2 * planned_m + 10) for v in places]
        if not places or here in places:
            continue  # a junction that is none, or that was seen as two
        if not any(found):
            break
        last = after
        legs += min(filter(None, found), key=len)
        here = legs[-1].target
    return legs


def sites_after(team, legs, seed):
    """Number of sites with a run along these legs, and whether it was merged where it was not."""
    new = simulate_run(
        team.world, settings=None, name="zz-next", seed=seed,
        world_name=next(iter(team.scenario.worlds)), route=legs,
    )  # fmt: skip
    maps = joined_pieces(build_map(new.run))
    result = merge_maps([*team.maps, *maps])
    truth = Truth(team.scenario.worlds, {**team.scenario.truth.runs, new.run.name: new.truth})
    vertex = {m.run: true_vertex_of_nodes(truth, m) for m in maps if m.run in truth.runs}
    known = {**team.vertex, **vertex}
    wrong = 0
    for pair in result.verdicts:
        if pair.accepted and {pair.a, pair.b} & vertex.keys():
            right = [known[pair.a][i] == known[pair.b][j] for i, j in pair.best.matched.tolist()]
            wrong += np.mean(right) < 0.5
    return len(result.components), wrong


def case(kind, overlap, seed):
    """What became of one team; None where its runs are one site, or should not be."""
    try:
        made = team(kind, overlap, seed)
    except UsageError:  # there is no room for such a team
        return None
    before = len(made.result.components)
    if before < 2 or len(made.scenario.truth.linked()) > 1:
        return None
    proposals = planning.drives(made.result)
    if not proposals:
        return kind, overlap, before, None
    first = proposals[0]
    legs = driven(made, first)
    length = sum(float(made.world.length[leg.edge]) for leg in legs)
    after, wrong = sites_after(made, legs, seed) if legs else (before, 0)
    chance = Chance("random drive", seed)
    known = sorted({int(v) for own in made.vertex.values() for v in own if v >= 0})
    start = known[chance.index(len(known))]
    random, wrong_too = sites_after(
        made, straight_on(made.world, start, 0.0, first.length_m, chance), seed
    )
    return kind, overlap, before, (first, length, after, random, wrong + wrong_too)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--spare", type=int, default=None)
    parser.add_argument("--each", action="store_true", help="a line for each case")
    options = parser.parse_args()
    if options.spare is not None:
        planning.DRIVES = planning.DriveSettings(spare_junctions=options.spare)
    rows, seed = [], options.first
    while len(rows) < options.cases:
        kind, overlap = KINDS[seed % 4], OVERLAPS[seed // 4 % 4]
        found = case(kind, overlap, seed)
        seed += 1
        if found is None:
            continue
        rows.append(found)
        if options.each and found[3] is not None:
            first, length, after, random, wrong = found[3]
            print(
                f"{seed - 1:4d} {kind:8s} {overlap:.2f} {found[2]} sites; "
                f"{'joins' if first.onto else 'explores'} {first.bits:5.1f} bits, planned "
                f"{first.length_m:4.0f} m, driven {length:4.0f} m: {after}; random {random}; "
                f"false {wrong}",
                flush=True,
            )
    print(f"{len(rows)} teams of {seed - options.first}, whose runs should be one site")
    print("first proposal      cases  sites fall  random drive  m planned  m driven  false")
    for title, chosen in (
        ("joins two sites", [r for r in rows if r[3] and r[3][0].onto]),
        ("into the unknown", [r for r in rows if r[3] and not r[3][0].onto]),
        *((kind, [r for r in rows if r[3] and r[0] == kind]) for kind in KINDS),
        ("all", [r for r in rows if r[3]]),
    ):
        if chosen:
            told = [
                np.mean([r[3][2] < r[2] for r in chosen]),
                np.mean([r[3][3] < r[2] for r in chosen]),
                np.median([r[3][0].length_m for r in chosen]),
                np.median([r[3][1] for r in chosen]),
            ]
            false = sum(r[3][4] for r in chosen)
            print(
                f"{title:18s} {len(chosen):6d} {told[0]:11.2f} {told[1]:13.2f} {told[2]:10.0f}"
                f" {told[3]:9.0f} {false:6d}"
            )


if __name__ == "__main__":
    main()
