"""Settings of robust merging."""

from __future__ import annotations

from dataclasses import dataclass

from ...topology.matching.likelihood import LIKELIHOOD


@dataclass(frozen=True, slots=True)
class RobustSettings:
    """Settings that may be tuned; the defaults are meant for every building.

    Everything that depends on how well a run was measured comes from its map's `RunNoise`. Effect
    of each number: `benchmarks/sensitivity.py`.
    """

    false_merge_rate: float = 1e-3
    """Upper bound of the probability that a whole batch holds any false merge: the user's
    choice."""
    min_matches: int = 5
    """Least number of matched junctions of a merge, plus up to one for every contradiction
    (`Conflicts.junctions`): four have no more than the 10 bits that two runs alone need
    (`junction_bits`). Without counting contradictions, tunnels are merged wrongly 21 times instead
    of 12 (of 15,660 pairs), mostly by five junctions of one standard part; of 2,688 right pairs one
    is lost."""
    copy_margin_bits: float = 4.0
    """The test for copies uses conservative rates: the share of copies that pass is below the
    promised one by this many bits (measured by `benchmarks/calibration.py`)."""
    copied_share: float = 0.75
    """Quantile over the maps of like buildings: their copies are assumed to be as large as in the
    map at this quantile. Pairs are many more than maps, and have larger copies than the two maps
    show by themselves: without it `benchmarks/aliasing.py --kinds tiles` joins tunnels wrongly.
    Over the whole batch, offices and rows keep mazes from being merged (`benchmarks/aliasing.py
    --mixed`)."""
    size_sigmas: float = 2.5
    """Two maps are not of one place if one is larger throughout by more than this many standard
    deviations of their odometries' scales. Of 310 right pairs of simulated runs the most is 2.3
    (the scales are conservative); of the same with one map 3 % larger 58 to 78 % have more."""
    hypotheses: int = 3
    """Candidate alignments grown per pair: the best, its rival, and one more in case that one of
    them does not grow. With two one of 104 pairs of tunnels is lost; with all that are beyond
    chance two runs of rows are merged wrongly."""
    growth_rounds: int = 6
    """Upper bound of the rounds of predict, match, refit. Tried: with 4 and 9 the same pairs are
    merged."""
    copy_variation: float = 0.02
    """Relative 1 sigma of the difference in length between two copies of one design. Conservative:
    with .03 one more pair of tunnels and one of offices are merged, with .013 two fewer of each."""
    copy_change_rate: float = 0.09
    """Share of junctions that differ between two copies, detection faults aside. Conservative: with
    .135 two more of 104 pairs of tunnels are merged, with .06 one and two of offices fewer."""

    def __post_init__(self) -> None:
        if not 0 < self.false_merge_rate < 1:
            raise ValueError(f"false_merge_rate must lie between 0 and 1: {self.false_merge_rate}")
        if self.min_matches < 2 or self.hypotheses < 2 or self.growth_rounds < 1:
            raise ValueError("min_matches and hypotheses must be 2 or more, growth_rounds positive")


DEFAULT_ROBUST = RobustSettings()


@dataclass(frozen=True, slots=True)
class MatchSettings:
    """Settings of matching; some are those of every likelihood (`LIKELIHOOD`). "Tried": on maps
    made by `benchmarks/aliasing.py`. Effect of each number: `benchmarks/sensitivity.py`."""

    lead_bits: float = 4.0
    """Required lead of the best alignment over the next best one and over its mirror image: odds of
    16 to 1. Also the lead over chance at which an alignment is reported and checked for
    contradictions. Tried: 2.7, no change; with 6 a pair of offices is lost."""
    junction_bits: float = 2.5
    """Bound on the agreement per matched junction: its terms are not independent. Of 297,000 pairs
    of unrelated mazes 8 reach 12.5 bits in five junctions, and 3 of these reach 16, where 1 should.
    Tried: with 3.75, 20 of 108 pairs of floors that differ by .3 m are merged wrongly instead of
    none (`benchmarks/adversaries.py`), with 1.7 a fifth of the right pairs is lost.

    Also the evidence against a copy that lengths and views share: of 132 pairs of twelve offices of
    one design, two runs at a time, two are merged wrongly if both count in full, none with this,
    and all twelve pairs of runs of one office are merged; with 4, nine.
    """
    least_share_of_bound: float = 0.25
    """Share of the bound on its agreement (`junction_bits`) up to which an alignment counts as a
    copy; from twice as much on it does not. Of 179 right pairs of mazes and organic ways all have
    .58 or more; of 25 pairs of floors of one plan, each junction moved by up to .3 m, 23 have less
    than half, and so do two sites that share a block (`benchmarks/adversaries.py`). It costs no
    right pair of the suites."""
    uniform_bits: float = 0.75
    """Bits of a length (-log2 of the density [1/m] of equal corridors) up to which the building is
    assumed to repeat itself; from twice as many on it is not. 90 % of pairs of maps have: rows -.3
    to .2, offices .2 to 1.4, tunnels 1.1 to 2.9, mazes 1.7 to 2.5, organic ways and cities more.
    Without it offices are merged wrongly (`benchmarks/aliasing.py --without uniform`)."""
    most_bits: float = LIKELIHOOD.most_bits
    fault_floor: float = LIKELIHOOD.fault_floor
    contradicted_bits: float = 7.0
    """Two junctions whose branches contradict each other by this much are not matched. Tried: with
    6 two of seven corridors that were closed between two runs are no longer reported (the junctions
    at their ends are no longer matched); without a bound, some pairs of tunnels are lost."""
    elsewhere_share: float = 0.25
    """Share of the corridors driven by both runs at a falsely matched junction, by the same branch,
    that lead elsewhere (mazes .45, tiles .28, offices .12, on maps made by
    `benchmarks/observed.py`)."""

    length_sigmas: float = LIKELIHOOD.gate_sigmas
    turn_rad: float = 0.35
    """Rotations that differ by less belong to one placement [rad]: 20°. Drift rotates parts of a
    map by less, and two placements in one building differ by a quarter turn. Tried: .23 and .53, no
    change."""
    place_m: float = 3.0
    """Shifts that differ by less belong to one placement [m], plus `drift_per_m` per metre of
    distance from the matches: most junctions are farther apart. Also the weight, as a lever [m], of
    the rotation of all matches in a local fit, and of the initial rotation. Tried: 2, no change;
    with 4.5 a pair of mazes is lost."""

    drift_per_m: float = 0.06
    """Error of predictions and placements per metre of distance from their support: `length_sigmas`
    of the drift that loop closure leaves. Across it is twice as much, because drift bends maps.
    Tried: .04, no change; with .09 one more pair of tunnels."""
    gate_m: float = LIKELIHOOD.gate_m
    reach_m: float = 7.5
    """Matches weigh exp(-d²/2 reach²) in predicting a junction at a distance of d [m]: drift bends
    maps over tens of metres, junctions lie about 6 m apart."""
    neighbours: int = 20
    """Neighbours of each junction whose matches predict it: about as many as lie within twice the
    reach."""
    fewest: int = 3
    """Least number of junctions of a match in every round of growth."""
    least_share: float = 0.6
    """A match is also given up if fewer of the junctions inside the other run's area are found:
    chance alone finds about a fifth of them. Tried: .4 and .5 give the same, but unrelated pairs
    take half as long again."""
    most_pairs: int = 20_000
    """Bound on the pairs that are compared at once. Of more compatible pairs of corridors those of
    the most common patterns are left out, which carry no information. Of more pairs of links that
    vote for a transform the weakest are left out. Up to so many pairs of points are compared
    exhaustively: one matrix product is faster than the 22 µs overhead of a tree query."""
    at_once: int = 4096
    """Junctions of hypotheses in a batch of growth, which fits a processor's cache; and pairs of
    maps in a batch of assessment (10 kB each)."""

    clear_m: float = 1.0
    """Length at either end of a corridor that belongs to the junction [m]; also the spacing of the
    sample points of the rest. Tried: .7 and 1.5, no change."""
    crossing_m: float = 1.7
    """Additional gate for junctions that a placement of views lays over each other: a crossing at
    an acute angle shows as two forks 1.1 to 1.55 m apart in a skeleton."""
    pair_digits: int = 4
    """Binary digits that the number of pairs is rounded up to: exact up to 15, beyond by up to an
    eighth, .17 bits, .06 in the mean. At 200 runs every tenth run is a step, at 1,420 every
    forty-fifth."""
    floor_rad: float = 0.03
    """Noise of branches beyond the estimated one [rad]: detectors depend on the direction of view.
    Without it tunnels repeat themselves more by chance, and fewer pairs of them are merged."""

    @property
    def contested_bits(self) -> float:
        """Required lead over another placement that is also beyond the threshold and has no more
        evidence against it; see `verdict._contested`."""
        return 2 * self.lead_bits

    @property
    def sure_m(self) -> float:
        """Distance from a match [m] beyond which, up to `near_m`, a junction is matched only if its
        branches agree and another one is matched nearby; and beyond which missing junctions do not
        end growth. Without that a false match far off spoils one of 90 pairs of mazes and organic
        ways, and three of 47 of tunnels. Tried for both limits: 10 and 12 merge three and one of
        780 pairs of tunnels wrongly, 15 none."""
        return 2 * self.reach_m

    @property
    def near_m(self) -> float:
        """Distance from a match [m] beyond which predictions are too uncertain to be used: their
        error equals that between two placements. The overlap of two runs need not be connected by
        corridors that both drove: with `sure_m` instead two of the 90 pairs are not merged, and of
        the 47 of tunnels, assessed in one batch, 39 instead of 43."""
        return (self.place_m - self.gate_m) / self.drift_per_m

    @property
    def soft_rad(self) -> float:
        """Branches this close to the border of two sectors are looked up in both [rad]: of two
        readings of one branch on both sides of it, one is no farther from it."""
        return self.turn_rad / 2


MATCH = MatchSettings()
