"""`topobatch site`: the name of a place that runs were recorded at."""

from __future__ import annotations

from typing import Annotated

import typer

from ..topology.errors import UsageError
from ..topology.wording import listed
from .journal import note
from .merge import rename_sites
from .options import DEFAULT_WORKSPACE, QuietOption, WorkspaceOption, complete_run
from .output import Screen
from .workspace import MERGED, Workspace, checked_file_name


def site(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN|SITE NAME ...",
            help="A run of the site, or its name so far, and what to call it from now on; several "
            "such pairs, one after the other.",
            autocompletion=complete_run,
        ),
    ],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    quiet: QuietOption = False,
) -> None:
    """Name sites: the places where runs that were merged were recorded.

    Every site has a name, which topobatch list shows: that of the folder of its logs, or what the
    names of its runs begin with, or "site-" and its oldest run. One that you give is kept
    (sites.json), as more runs come and others go. Two sites that become one keep the name that most
    runs have; of a site that comes apart, the larger part keeps it. Exports are called like their
    site. Nothing is matched again: only the names in the merges change. Several may be named at
    once: topobatch site run1 north run7 east.

    \b
      topobatch site run1 north
      topobatch export --site north --format nav2
      topobatch draw north north.svg
    """
    if len(words) % 2:
        raise UsageError(f"a run and a name for its site are needed; {words[-1]!r} is alone")
    place, screen = Workspace(workspace), Screen(quiet)
    with place.held(screen.warn, make=False):
        before = place.sites()
        try:
            told = [_name(place, *pair) for pair in zip(words[::2], words[1::2], strict=True)]
            rename_sites(place, screen)
        except UsageError:
            place.write_sites(before)
            raise
        for line in told:
            note(place, "site", line, screen.warn)
            screen.line(f"site {line}")
    if not place.merged_json.is_file():
        screen.line(f"next: {place.call('merge', '--all')}")


def _name(place: Workspace, run: str, name: str) -> str:
    """Keep the name of one site; it and its runs in words."""
    sites, runs = _called(place, run)
    _check(place, name, sites, runs)
    old = {sites.get(each) for each in runs} | {name}
    left = {s: [each for each in own if each not in runs] for s, own in place.sites().items()}
    kept = {site: own for site, own in left.items() if site not in old and own}
    place.write_sites({**kept, name: runs})
    return f"{name}: {listed(runs)}"


def _called(place: Workspace, run: str) -> tuple[dict[str, str], list[str]]:
    """The site of every run of the last merge, and the runs of the named one."""
    from ..merge.document import read_merged

    components: list[list[str]] = []
    sites: dict[str, str] = {}
    if place.merged_json.is_file():
        graph = read_merged(place.merged_json).graph
        components, sites = [sorted(c.runs) for c in graph.components], graph.sites
    known = place.runs()
    at = [runs for runs in components if run in runs or sites.get(runs[0]) == run]
    if run in known:
        at = [runs for runs in at if run in runs] or [[run]]
    if not at:
        raise place.unknown([run], "run or site named")
    return sites, at[0]


def _check(place: Workspace, name: str, sites: dict[str, str], runs: list[str]) -> None:
    """UsageError if a site cannot be called so."""
    from ..merge.merged_schema import is_site_name

    checked_file_name(name, "a site")
    if not is_site_name(name):
        raise UsageError(f"{name!r} cannot name a site: it must work as a file name")
    if name in place.runs() and runs != [name]:
        raise UsageError(f"{name!r} cannot name a site: a run is called so")
    if name.casefold() == MERGED or name in [each.merge for each in place.merges()]:
        raise UsageError(f"{name!r} cannot name a site: a merge is called so")
    others = sorted(run for run, site in sites.items() if site == name and run not in runs)
    if others:
        same = place.call("lock", runs[0], others[0], "--same")
        raise UsageError(
            f"there is a site {name!r} already ({listed(others, 3)}); if {runs[0]} is of it: {same}"
        )
