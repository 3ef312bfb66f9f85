"""Settings of trusted merging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from ...topology.matching.likelihood import LIKELIHOOD


@dataclass(frozen=True, slots=True)
class RobustSettings:
    """What may be tuned; the defaults are meant for every building.

    Everything that depends on how well a run was measured comes from its map's `RunNoise`. What
    each number is worth: `benchmarks/sensitivity.py`.
    """

    false_merge_rate: float = 1e-3
    """Chance that a whole batch holds any false merge, at most: the user's choice."""
    min_matches: int = 5
    """Fewer matched junctions than this, one less for every contradiction, are never merged: four
    carry no more than the 10 bits that two runs alone need (`junction_bits`). With contradictions
    uncounted two runs in tunnels are merged wrongly 21 times for 12 (of 15,660 pairs), most of them
    by five junctions of one standard part; of 2,688 right pairs one is lost."""
    copy_margin_bits: float = 4.0
    """The second question is asked with cautious rates: of copies, fewer than promised pass it by
    this many bits (measured by `benchmarks/calibration.py`)."""
    copied_share: float = 0.75
    """A batch has copies as large as its map at this quantile shows: most maps repeat, or few do.
    Pairs are many more than maps, and meet larger copies than the two maps show by themselves:
    without it `benchmarks/aliasing.py --kinds tiles` joins tunnels wrongly."""
    size_sigmas: float = 2.5
    """Two maps of which the one is longer throughout by more than their odometries' scales explain
    are not of one place. Of 310 right pairs of simulated runs the most is 2.3 (the scales are
    stated with caution); of the same with one map 3 % larger 58 to 78 % have more."""
    hypotheses: int = 3
    """Candidate alignments grown per pair that may be merged: the best, its rival, and one more in
    case that one of them grows into nothing. With two a pair takes 8 % less time, and a few offices
    are lost; with as many as are beyond chance two runs of rows are merged wrongly."""
    growth_rounds: int = 6
    """Rounds of predict, match, refit, at most. Tried: with 4 and 9 the same pairs are told."""
    copy_variation: float = 0.02
    """Relative 1 sigma by which lengths differ between two copies of one design. Cautious: with
    .03 one more of 100 pairs of tunnels is told, with .013 six fewer."""
    copy_change_rate: float = 0.09
    """Share of junctions that differ between two copies, faults of the runs aside. Cautious: with
    .135 one more of 100 pairs of tunnels is told, with .06 five fewer."""

    def __post_init__(self) -> None:
        if not 0 < self.false_merge_rate < 1:
            raise ValueError(f"false_merge_rate must lie between 0 and 1: {self.false_merge_rate}")
        if self.min_matches < 2 or self.hypotheses < 2 or self.growth_rounds < 1:
            raise ValueError("min_matches and hypotheses must be 2 or more, growth_rounds positive")


DEFAULT_ROBUST = RobustSettings()


@dataclass(frozen=True, slots=True)
class MatchSettings:
    """What matching counts with; some of it is that of every likelihood (`LIKELIHOOD`). "Tried": on
    maps made by `benchmarks/aliasing.py`. What each number is worth: `benchmarks/sensitivity.py`.
    """

    lead_bits: float = 4.0
    """What the best alignment must lead the next best one and its mirror image by: odds of 16 to 1.
    And what it must lead chance by to be worth a word, or to be searched for contradictions. Tried:
    2.7 and 6, the same."""
    junction_bits: float = 2.5
    """Most that one matched junction counts: few junctions overstate what they tell. Of 297,000
    pairs of unrelated mazes 8 reach 12.5 bits in five junctions, and 3 of these reach 16, where 1
    should. Tried: with 3.75 of 1,900 pairs 28 are merged wrongly, with 1.7 a seventh of
    the right ones is lost."""
    least_told: float = 0.25
    """Share of `junction_bits` up to which an alignment is taken for a copy; from twice as much on
    it is not. Of 179 right pairs of mazes and organic ways all tell .58 or more; of 25 pairs of
    floors of one plan, each junction moved by up to .3 m, 23 tell less than half, and so do two
    sites that share a block (`benchmarks/adversaries.py`). It costs no right pair of the suites."""
    uniform_bits: float = 0.75
    """-log2 of the density [1/m] of equal corridors up to which it is assumed that the building
    repeats itself, seen or not; from twice as many on it is not. 90 % of pairs of maps have: rows
    -.3 to .2, offices .2 to 1.4, tunnels 1.1 to 2.9, mazes 1.7 to 2.5, organic ways and cities
    more. Without it offices are merged wrongly (`benchmarks/aliasing.py --without uniform`)."""
    most_bits: float = LIKELIHOOD.most_bits
    fault_floor: float = LIKELIHOOD.fault_floor
    contradicted_bits: float = 7.0
    """Two junctions whose branches tell so much against each other are not matched. Tried: with 6
    two of seven corridors that were closed between two runs are no longer told to be (the junctions
    at their ends are no longer matched); with no bound, some pairs of tunnels are lost."""
    elsewhere_share: float = 0.25
    """Of the corridors that two runs drove by one branch of a falsely matched junction so many lead
    elsewhere (mazes .45, tiles .28, offices .12, on maps made by `benchmarks/observed.py`)."""

    length_sigmas: float = LIKELIHOOD.gate_sigmas
    turn_rad: float = 0.35
    """Rotations that differ by less belong to one placement [rad]: 20°. Drift turns parts of a map
    by less, and two placements of one building differ by a quarter turn. Tried: .23 and .53, the
    same."""
    place_m: float = 3.0
    """So do shifts [m], and `drift_per_m` more per metre to where they were found: most junctions
    are farther apart. Also the lever [m] that all matches together have beside the near ones, and
    the rotation that they began with. Tried: 2, the same; with 4.5 a pair of mazes is lost."""

    drift_per_m: float = 0.06
    """Predictions and placements are off by no more per metre to what they rest on: `length_sigmas`
    of what is left of drift after loop closure. Across it is twice as much: it bends maps. Tried:
    .04 and .09, the same."""
    gate_m: float = LIKELIHOOD.gate_m
    reach_m: float = 7.5
    """Matches weigh exp(-d²/2 reach²) in predicting a junction d metres away: drift bends maps over
    tens of metres, junctions lie some 6 m apart."""
    neighbours: int = 20
    """Junctions around each junction whose matches predict where it lies in the other map: as many
    as lie within twice the reach."""
    fewest: int = 3
    """A match that does not reach this many junctions in a round of growth is given up …"""
    least_share: float = 0.6
    """… and so is one in which fewer of the junctions that lie where the other run has been are
    found: chance alone finds about a fifth of them. Tried: .4 and .5 give the same, but unrelated
    pairs take half as long again."""
    weak_share: float = 0.3
    """Hypotheses with less than this share of the best one's bits are not grown."""
    most_pairs: int = 20_000
    """Pairs of anything that are compared at once, for the sake of time. Where more pairs of
    corridors look alike, those of the commonest patterns are left out: a link to a corridor of
    which there are hundreds tells nothing. Where more pairs of links would vote for a transform,
    the weakest do not. And up to so many pairs of points are compared outright: one product of
    matrices is faster than the 22 µs that asking a tree takes before it begins."""
    at_once: int = 4096
    """Junctions of hypotheses that are grown at once (what is worked out of them fits the cache of
    a processor), and pairs of maps that are judged at once (10 kB each)."""

    clear_m: float = 1.0
    """Nearer than this to its ends a corridor is the junctions' own [m]; also the spacing of the
    points that stand for the rest of it. Tried: .7 and 1.5, the same."""
    crossing_m: float = 1.7
    """Skeletons show a crossing as two forks up to so far apart [m]: the detector joins those up to
    1.0 m apart (one variant for saved grids 1.3 m); of the acute crossings of organic ways that it
    shows as two, the forks lie 1.1 to 1.55 m apart."""
    ranked_decimals: int = 6
    """Decimals of evidence [bits] by which placements are ranked: copies that are built alike have
    the same but for rounding, which is no order. Sums of a thousand bits are rounded at the twelfth
    decimal, documents at the second."""
    pair_digits: int = 4
    """Binary digits of a number of pairs: up to 15 it is exact, beyond it is rounded up by up to
    an eighth, .17 bits, .06 in the mean. At 200 runs every tenth run is a step, at 1,420 every
    forty-fifth."""
    floor_rad: float = 0.03
    """Noise of branches that no estimate holds [rad]: detectors that turn with the view. Without it
    tunnels repeat themselves more by chance, and fewer pairs of them are told."""

    @property
    def contested_bits(self) -> float:
        """The lead over a placement that is beyond the threshold, too, with no more against it: why
        says `verdict.py: _contested`."""
        return 2 * self.lead_bits

    @property
    def sure_m(self) -> float:
        """Farther from a match, up to `near_m`, a junction is matched only if its branches agree
        and another is matched beside it [m]; and a match is not given up for what is not found
        there. Without that a false match far off spoils one of 90 pairs of mazes and organic ways,
        and three of 47 of tunnels. Tried for both limits: 10 and 12 merge three and one of 780
        pairs of tunnels wrongly, 15 none."""
        return 2 * self.reach_m

    @property
    def near_m(self) -> float:
        """Farther from a match predictions are too vague to be looked at [m]: off by as much as
        parts two placements. What two runs share need not hang together by what both drove: with
        `sure_m` in its place two of the 90 pairs are not told, and of the 47 of tunnels, judged in
        one batch, 39 for 43."""
        return (self.place_m - self.gate_m) / self.drift_per_m

    @property
    def soft_rad(self) -> float:
        """Branches this close to the border of two sectors are looked up in both [rad]: of two that
        may be the same and lie on both sides of it, one is no farther from it."""
        return self.turn_rad / 2


MATCH = MatchSettings()


def settings_from_document(values: Mapping[str, Any]) -> RobustSettings:
    """The settings that a merged document names; those that it does not have their defaults.
    Raises ValueError on values that cannot be."""
    known: dict[str, Any] = {}
    for field in fields(RobustSettings):
        value = values.get(field.name, field.default)
        whole = isinstance(field.default, int)
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            number = "a whole number" if whole else "a number"
            raise ValueError(f"{field.name} must be {number}: {value!r}")
        known[field.name] = value
    return RobustSettings(**known)
