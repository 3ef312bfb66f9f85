"""Sites: names of a merge's components that stay from merge to merge.

A component takes the name that most of its runs had in the last merge; one given by a person comes
before those that were made up. So new runs, renamed runs and other verdicts change no name that
they need not change. The names follow from the components, the names given and the last merge
alone, in whatever order the runs are.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any, Literal

from pydantic import Field

from ..topology.map_schema import Model, validated
from ..topology.wording import listed
from .merged_schema import SiteName, is_site_name

SITES_SCHEMA: Literal["topobatch.sites/1"] = "topobatch.sites/1"

Given = Mapping[str, tuple[str, ...]]
"""Names that a person gave, with the runs that were at each site."""


@dataclass(frozen=True, slots=True)
class SiteHistory:
    """What is known of sites before a merge. given: by a person; before: the site of every run in
    the last merge, where it had one."""

    given: Given = field(default_factory=dict)
    before: Mapping[str, str] = field(default_factory=dict)

    def site_of(self, run: str) -> str | None:
        """The site that a run counts for: the one that a person named, else that of the last merge.
        The name that a run alone has of itself binds nobody."""
        named = next((site for site, runs in self.given.items() if run in runs), None)
        before = self.before.get(run)
        return named or (None if before == run else before)


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a run comes from, for the name of its site. folder: that of its log, from the root on;
    first_ns: time of its first junction pass, None without any."""

    folder: tuple[str, ...] = ()
    first_ns: int | None = None


def site_names(
    components: Sequence[Collection[str]],
    history: SiteHistory,
    origins: Mapping[str, Origin],
    taken: Collection[str] = (),
) -> list[str]:
    """The name of every component, given as its runs.

    origins: of every run; taken: names that mean something else, which no new site gets. O(runs ·
    names given).
    """
    kept = _kept_names(components, history, origins)
    sites, others = {*history.given, *filter(None, kept)}, {*taken, *origins}
    groups = [runs for runs in components if len(runs) > 1]
    names: list[str] = []
    for runs, name in zip(components, kept, strict=True):
        own = runs if len(runs) == 1 else ()
        used = others.difference(own).union(sites, names)
        names.append(name or _new_name(runs, groups, origins, used))
    return names


def _kept_names(
    components: Sequence[Collection[str]], history: SiteHistory, origins: Mapping[str, Origin]
) -> list[str | None]:
    """The known name of every component, None for a new site. A name goes to the component with
    most of its runs, among equals to that of the oldest run."""
    votes: dict[str, Counter[int]] = {}
    for k, runs in enumerate(components):
        for site in filter(None, map(history.site_of, runs)):
            votes.setdefault(site, Counter())[k] += 1
    oldest = [_oldest(runs, origins) for runs in components]
    claims: dict[int, list[tuple[bool, int, str]]] = {}
    for site, count in votes.items():
        k = min(count, key=lambda k: (-count[k], oldest[k]))
        claims.setdefault(k, []).append((site not in history.given, -count[k], site))
    return [min(claims[k])[2] if k in claims else None for k in range(len(components))]


def _oldest(runs: Iterable[str], origins: Mapping[str, Origin]) -> tuple[bool, int, str]:
    """The oldest run: whether it has no time, its time, its name."""
    times = ((origins[run].first_ns, run) for run in runs)
    return min((first_ns is None, first_ns or 0, run) for first_ns, run in times)


def _new_name(
    runs: Collection[str],
    groups: Sequence[Collection[str]],
    origins: Mapping[str, Origin],
    taken: Collection[str],
) -> str:
    """A name for a new site: that of its only run; else the folder of its logs, if no other run is
    from there; else the beginning of its runs' names, if no other run's name begins so; else that
    folder, if no other of the groups of several runs is from there; else "site-" and its oldest
    run."""
    *_, oldest = _oldest(runs, origins)
    if len(runs) == 1:
        options = [oldest]
    else:
        others = [run for run in origins if run not in runs]
        grouped = [run for group in groups if group is not runs for run in group]
        folders = {run: origin.folder for run, origin in origins.items()}
        options = [
            *_shared_folder(runs, others, folders),
            *_shared_beginning(runs, others),
            *_shared_folder(runs, grouped, folders),
            f"site-{oldest}",
        ]
    if not is_site_name(options[-1]):  # earlier versions had colons in names of runs
        options[-1] = "site"
    numbered = (f"{options[-1]}-{n}" for n in range(2, len(taken) + 3))
    return next(name for name in (*options, *numbered) if name not in taken)


OF_NO_PLACE = ("bag", "data", "log", "map", "mcap", "recording", "rosbag", "run")
"""Names of folders, plural or not, that say what is in them and not where that was recorded."""


def _shared_folder(
    runs: Collection[str], others: Iterable[str], folders: Mapping[str, tuple[str, ...]]
) -> list[str]:
    """The name of the folder that all logs of some runs, and of no others, are below, if it names
    a place."""
    shared = tuple(_beginning([folders[run] for run in runs]))
    if not shared or any(folders[run][: len(shared)] == shared for run in others):
        return []
    name = shared[-1]
    return [name] if is_site_name(name) and name.lower().rstrip("s") not in OF_NO_PLACE else []


def _shared_beginning(runs: Collection[str], others: Iterable[str]) -> list[str]:
    """What the names of some runs, and of no others, begin with, if it can name a site."""
    shared = re.sub(r"\d+$", "", "".join(_beginning([*runs])))  # the number that they differ in
    shared = re.sub(r"[\W_][\W\d_]*$", "", shared)
    named = is_site_name(shared) and not re.fullmatch(r"[\W\d_]*", shared)
    if not named or any(run.startswith(shared) for run in others):
        return []
    return [shared]


def _beginning(sequences: Sequence[Sequence[str]]) -> list[str]:
    """What all of the sequences begin with."""
    columns = takewhile(lambda column: len(set(column)) == 1, zip(*sequences, strict=False))
    return [column[0] for column in columns]


def moved_sites(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Sentences on sites that became one, and on those that came apart. before, now: the site of
    every run."""
    came: dict[str, list[str]] = {}
    went: dict[str, list[str]] = {}
    for old, new in sorted({(before[run], new) for run, new in now.items() if run in before}):
        went.setdefault(old, []).append(new)
        # A run that was alone, at a site called like it, is no site that became part of one.
        if before.get(old) != old:
            came.setdefault(new, []).append(old)
    gone = {*before.values()} - {*now.values()}
    one = {new: old for new, old in came.items() if len(old) > 1 and gone & {*old}}
    apart = {old: new for old, new in went.items() if len(new) > 1}
    return [
        *(f"{listed(old)} are one site now: {new}" for new, old in one.items()),
        *(f"{old} came apart: {listed(new)}" for old, new in apart.items()),
    ]


class SiteEntry(Model):
    """A name in the document."""

    site: SiteName
    runs: list[str]


class SitesDocument(Model):
    """`sites.json`."""

    schema_name: Literal["topobatch.sites/1"] = Field(alias="schema")
    sites: list[SiteEntry]


def sites_to_document(given: Mapping[str, Iterable[str]]) -> dict[str, Any]:
    """The document of names that a person gave, sorted; inverse of `sites_from_document`."""
    entries = [{"site": site, "runs": sorted(runs)} for site, runs in sorted(given.items())]
    return {"schema": SITES_SCHEMA, "sites": entries}


def sites_from_document(doc: Any, name: str = "sites document") -> dict[str, tuple[str, ...]]:
    """The names that a person gave; DocumentError if the document follows no such schema."""
    return {e.site: tuple(sorted(e.runs)) for e in validated(SitesDocument, doc, name).sites}
