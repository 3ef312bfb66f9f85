"""Layers of maps (§4.1): the matches through which a run's map depends on another's.

Layer 0 is a run's own map. Layer 1 holds the maps matched to it, layer n + 1 those matched to maps
of layer n; every map above layer 0 names the match that it depends on.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .result import PairVerdict


def layers_to_document(own: str, verdicts: Iterable[PairVerdict]) -> list[dict[str, Any]]:
    """JSON rows {"run", "layer", "depends_on"} of all runs connected to `own` by accepted verdicts.

    By layer, then by name. A map that several maps of the layer below match depends on the
    strongest of these matches.
    """
    accepted = [v for v in verdicts if v.accepted]
    rows: list[dict[str, Any]] = [{"run": own, "layer": 0, "depends_on": None}]
    placed, below = {own}, {own}
    while below:
        best: dict[str, tuple[float, str]] = {}
        for v in accepted:
            for run, base in ((v.a, v.b), (v.b, v.a)):
                if base in below and run not in placed:
                    rank = (-v.evidence_bits, base)
                    best[run] = min(best.get(run, rank), rank)
        layer = rows[-1]["layer"] + 1
        rows += [{"run": run, "layer": layer, "depends_on": best[run][1]} for run in sorted(best)]
        below = set(best)
        placed |= below
    return rows
