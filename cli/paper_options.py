"""Options of the paper's method, shared by commands, and the settings from them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from ..topology.errors import UsageError
from .options import flag

if TYPE_CHECKING:
    from ..merge.paper.method import PaperSettings


@dataclass(frozen=True, slots=True)
class PaperOptions:
    """The options given; None for others."""

    panel: ClassVar = "Options of --method paper"

    degree: Annotated[
        Literal["exact", "inexact"] | None,
        "--degree",
        "Must matched junctions have equally many branches (exact: a static world, the default), "
        "or may doors open and close, so that one may be missing (inexact)? (§2.1)",
    ] = None
    confidence: Annotated[
        float | None,
        "--confidence P",
        "Probability that a correct match passes the comparison of its corridors' lengths; default "
        "0.999. Closer to 1: fewer correct matches are rejected, but more agree by chance, so that "
        "each is weaker evidence.",
    ] = None
    confidence_of: Annotated[
        Literal["match", "corridor"] | None,
        "--confidence-of",
        "What --confidence applies to. match, the default: all corridors of a match together; "
        "corridor: each by itself, so that a correct match of k corridors passes with P ** k. As "
        "published: --confidence 0.95 --confidence-of corridor. (§5)",
    ] = None
    weights: Annotated[
        Literal["equal", "reweighted"] | None,
        "--weights",
        "Weights of matched junctions when one map is fitted to the other. equal, the default: all "
        "count alike, so that one far off shows a bad match; reweighted: junctions far off count "
        "less, for maps that are bent in places. (§3.1)",
    ] = None
    iterative: Annotated[
        bool | None,
        "--iterative/--once",
        "How matches are clustered. --once: by their own transforms, as published. --iterative: "
        "also matches of other transforms join, as those of few junctions may have, if the "
        "cluster's transform lays their junctions on each other; repeated until nothing changes. "
        "(§5)",
    ] = None
    met: Annotated[
        list[str] | None,
        "--met RUN@TIME,RUN@TIME",
        "Two robots were near each other, each at a time of its own log: matches are grown from "
        "junctions near both only. In nanoseconds, or in seconds with a decimal point. May be "
        "given several times. (§4.2)",
    ] = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "met", self.met or None)

    def refuse(self) -> None:
        """UsageError if any was given: other methods have none of them."""
        if self != PaperOptions():
            *most, last = (flag(field.name) for field in fields(self))
            raise UsageError(f"{', '.join(most)} and {last} belong to --method paper")

    def over(self, settings: PaperSettings) -> PaperSettings:
        """The settings with the given options replaced; UsageError if they are invalid."""
        from ..merge.paper.meeting import parse_meeting

        def given(*names: str) -> dict[str, Any]:
            return {k: v for k in names if (v := getattr(self, k)) is not None}

        growth = given("degree", "confidence", "confidence_of")
        return replace(
            settings,
            growth=replace(settings.growth, **growth),
            clusters=replace(settings.clusters, **given("weights", "iterative")),
            meetings=tuple(map(parse_meeting, self.met or ())) or settings.meetings,
        )
