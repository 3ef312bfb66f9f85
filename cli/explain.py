"""`topobatch explain`: what matching found between two maps, and why the verdict is what it is."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..topology.errors import UsageError
from .options import DEFAULT_WORKSPACE, WorkspaceOption
from .output import say, say_lines
from .workspace import Workspace

if TYPE_CHECKING:
    from ..merge.document import MergeEntry


def explain(
    a: Annotated[str, typer.Argument(help="A run.")],
    b: Annotated[str, typer.Argument(help="Another run.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    rows: Annotated[
        int, typer.Option(min=1, help="Rows of a table, and clusters, to print at most.")
    ] = 20,
) -> None:
    """Show how two maps match: hypotheses, clusters, verdict.

    The figures of Huang & Beevers for any two maps: the table of vertex pairs with the hypotheses
    they belong to (Fig. 1), the clusters in transform space with their sizes and errors (Fig. 2);
    and what the last merge said about the pair. The same as a recording in explain/A+B.rrd.
    """
    if a == b:
        raise UsageError(f"two runs are needed, got {a!r} twice")
    from ..merge.explain import explain as explained
    from ..merge.explain import lines, to_document
    from ..viz import write_explain_recording

    place = Workspace(workspace)
    first, second = place.chosen_runs([a, b], False)
    map_a, map_b = (place.read_map(run) for run in (first, second))
    found = explained(map_a, map_b)
    recording = place.explain_rrd(first, second)
    write_explain_recording(recording, map_a, map_b, found)
    said = _said(place, first, second)
    if as_json:
        say_lines(json.dumps(to_document(found) | {"verdict": said and said.model_dump()}))
        return
    for line in lines(found, rows):
        say(line)
    say()
    for line in _verdict_lines(said):
        say(line)
    say(f"recording: {recording}")


def _said(place: Workspace, a: str, b: str) -> MergeEntry | None:
    """What merged.json says about a pair, if it says anything."""
    from ..merge.document import read_merged

    if not place.merged_json.exists():
        return None
    merges = read_merged(place.merged_json).merges
    return next((entry for entry in merges if (entry.a, entry.b) == (a, b)), None)


def _verdict_lines(said: MergeEntry | None) -> list[str]:
    if said is None:
        return ["verdict: not merged yet; topobatch merge --all"]
    lines = [f"verdict: {said.verdict}, {said.evidence_bits:.1f} bits: {said.reason}"]
    more: dict[str, Any] = said.model_extra or {}
    lines += [f"  against it: {sentence}" for sentence in more.get("contradictions", ())]
    if said.runner_up is not None:
        at = said.runner_up.transform
        lines.append(
            f"  next best: {said.runner_up.evidence_bits:.1f} bits, "
            f"{len(said.runner_up.matched)} junctions, at ({at.x:.2f}, {at.y:.2f}) m, "
            f"{at.theta:.3f} rad"
        )
    if more.get("advice"):
        lines.append(f"  to settle it: {more['advice']}")
    return lines
