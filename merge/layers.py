"""Layers of maps (§4.1): whose map rests on whose, and what falls when a match is discarded.

Layer 0 is a run's own map. Layer 1 holds the maps matched to it, layer n + 1 those matched to maps
of layer n; every map above layer 0 names the match that it depends on. Nothing is copied: the own
maps are kept whole, so a match can be discarded at any time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from .result import PairVerdict, Verdict


@dataclass(frozen=True, slots=True)
class Layered:
    """A run in a layer: the run of the layer below that it was matched to, None in layer 0."""

    run: str
    layer: int
    depends_on: str | None


@dataclass(frozen=True, slots=True)
class Layers:
    """All runs that matches tie to `own`, by layer, then by name."""

    own: str
    maps: tuple[Layered, ...]

    def layer_of(self, run: str) -> int | None:
        """The layer of a run, None if no match leads to it."""
        return next((m.layer for m in self.maps if m.run == run), None)

    def dependents(self, run: str) -> tuple[str, ...]:
        """Runs that rest on the match of `run` to the layer below, itself first."""
        fallen = [run]
        for m in self.maps:  # by layer, so what a map depends on comes before it
            if m.depends_on in fallen and m.run not in fallen:
                fallen.append(m.run)
        return tuple(fallen)


def layers(own: str, verdicts: Iterable[PairVerdict]) -> Layers:
    """The layers around the map of `own`, from accepted verdicts.

    A map that several maps of the layer below match depends on the strongest of these matches.
    """
    accepted = [v for v in verdicts if v.accepted]
    found = {own: Layered(own, 0, None)}
    below = [own]
    while below:
        best: dict[str, tuple[float, str]] = {}
        for v in accepted:
            for run, base in ((v.a, v.b), (v.b, v.a)):
                if base in below and run not in found:
                    rank = (-v.evidence_bits, base)
                    best[run] = min(best.get(run, rank), rank)
        layer = found[below[0]].layer + 1
        found |= {run: Layered(run, layer, base) for run, (_, base) in sorted(best.items())}
        below = sorted(best)
    return Layers(own, tuple(sorted(found.values(), key=lambda m: (m.layer, m.run))))


def discard_match(verdicts: Sequence[PairVerdict], a: str, b: str) -> tuple[PairVerdict, ...]:
    """The verdicts without the match of two runs: the pair is unrelated, as if nothing was found.

    What depended on it falls with it when layers or the fused map are built again; a map that
    another match supports as well stays.
    """
    low, high = sorted((a, b))
    return tuple(
        PairVerdict(low, high, Verdict.UNRELATED, False, 0.0, "the match was discarded")
        if (v.a, v.b) == (low, high)
        else v
        for v in verdicts
    )


def discard_dependents(
    verdicts: Sequence[PairVerdict], own: str, a: str, b: str
) -> tuple[PairVerdict, ...]:
    """The verdicts without a match and without every match that depends on it, seen from `own`.

    §4.1: "discard hypotheses that are later determined to be incorrect, along with all other
    hypotheses that depend on them". Matches between maps that rest on it are kept but no longer
    reach `own`; those from there to other layers fall.
    """
    view = layers(own, verdicts)
    upper = next((m for m in view.maps if m.run in (a, b) and m.depends_on in (a, b)), None)
    left = discard_match(verdicts, a, b)
    if upper is None:
        return left
    fallen = set(view.dependents(upper.run))
    return tuple(
        _refused(v) if v.accepted and (v.a in fallen) != (v.b in fallen) else v for v in left
    )


def _refused(verdict: PairVerdict) -> PairVerdict:
    reason = f"{verdict.reason}; depends on a match that was discarded"
    return replace(verdict, accepted=False, reason=reason)


def layers_to_document(own: str, verdicts: Iterable[PairVerdict]) -> list[dict[str, Any]]:
    """JSON rows {"run", "layer", "depends_on"} of the layers around `own`."""
    view = layers(own, verdicts)
    return [{"run": m.run, "layer": m.layer, "depends_on": m.depends_on} for m in view.maps]
