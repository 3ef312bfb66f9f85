"""What a person decides about the runs of a workspace: `topobatch lock`, `discard`, `rename` and
`site`."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from itertools import chain
from typing import Annotated

from ..merge.locks import Lock, with_lock, without_lock
from ..topology.document import write_map
from ..topology.errors import DataError, UsageError
from ..topology.files import write_json
from ..topology.wording import listed
from ..viz.exports import ENDINGS
from .ingest_record import PIECE
from .journal import note
from .options import RUNS, Here, QuietOption, verb
from .output import say, show
from .workspace import MERGED, Workspace, checked_file_name, pair_named

Pair = tuple[str, str]


@verb
def lock(
    a: Annotated[str | None, "A", "A run.", RUNS] = None,
    b: Annotated[str | None, "B", "Another run.", RUNS] = None,
    same: Annotated[
        bool, "--same", "The two share places: join them, where they fit best."
    ] = False,
    never: Annotated[bool, "--never", "They share nothing: keep them apart, always."] = False,
    clear: Annotated[bool, "--clear --undo", "Forget what was said about the two."] = False,
    at: Annotated[
        str | None,
        "--at JUNCTIONS",
        "With --same: a junction of A and the junction of B that is the same place, by the numbers "
        'their maps give them: "3,7".',
    ] = None,
    *,
    place: Here,
) -> None:
    """Say that two runs belong together, or never do.

    Kept in the workspace (locks.json) and honoured by every later merge, which warns where the maps
    speak against --same (it may be another copy of the place, they contradict each other); --clear
    takes the lock back. Without runs, lists the locks.

    \b
      topobatch lock run1 run2 --same
      topobatch lock run1 run2 --same --at 3,7
      topobatch lock run1 run3 --never
      topobatch merge --all
    """
    if a is None or b is None:
        if a is not None or same or never or clear or at is not None:
            raise UsageError("name two runs: topobatch lock A B --same (or --never, or --clear)")
        place.require()
        _show_locks(place.locks())
        return
    if same + never + clear != 1:
        raise UsageError("say one of --same, --never and --clear")
    if at is not None and not same:
        raise UsageError("--at goes with --same")
    wanted = None if clear else Lock(a, b, "same" if same else "never", _junctions(at))
    place.require()
    if wanted is not None:
        place.chosen_runs([a, b])
        _check_lock(place, wanted)
    with place.held():
        locks = place.locks()
        kept = without_lock(locks, a, b) if wanted is None else with_lock(locks, wanted)
        place.decide(locks=kept)
        done = "clear" if wanted is None else wanted.decision
        note(place, "lock", f"{min(a, b)} + {max(a, b)}: {done}")
    _show_locks(kept)
    say(f"next: {place.call('merge', '--all')}")


def _junctions(at: str | None) -> tuple[int, int] | None:
    if at is None:
        return None
    found = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*", at)
    if found is None:
        raise UsageError(f'--at is {at!r}; it names a junction of A and one of B, like "3,7"')
    return int(found[1]), int(found[2])


def _check_lock(place: Workspace, lock: Lock) -> None:
    """UsageError if the match of the runs was discarded, or a junction does not exist."""
    if lock.decision == "same" and (lock.a, lock.b) in place.discards():
        first = place.call("discard", f"{lock.a}:{lock.b}", "--undo")
        raise UsageError(f"the match of {lock.a} and {lock.b} was discarded; first: {first}")
    for run, vertex in zip((lock.a, lock.b), lock.at or (), strict=False):
        junctions = len(place.read_map(run))
        if vertex >= junctions:
            raise UsageError(f"{run} has junctions 0 … {junctions - 1}, not {vertex}")


def _show_locks(locks: tuple[Lock, ...]) -> None:
    for entry in locks or ["no locks"]:
        say(str(entry))


@verb
def discard(
    what: Annotated[list[str] | None, "RUN|A:B", "Runs, or matches of two runs.", RUNS] = None,
    undo: Annotated[bool, "--undo", "Let the matches A:B count again."] = False,
    *,
    place: Here,
    quiet: QuietOption = False,
) -> None:
    """Take back runs, or matches of two runs.

    What depends on them goes with them. RUN: its map, recordings, exports and locks are removed;
    its log, ingested again, makes it anew. A:B: what was found between the two is not counted any
    more, in the merges that there are and in later ones; other runs may still join them (to keep
    them apart whatever is found: topobatch lock A B --never). Merges that hold any of the runs are
    made anew without it. Without arguments, lists the matches that were taken back.

    \b
      topobatch discard run1:run2
      topobatch discard run1:run2 --undo
      topobatch discard run3
    """
    from .merges import made_again

    show(quiet=quiet)
    if not what:
        if undo:
            raise UsageError("--undo: name the matches, A:B")
        place.require()
        for line in sorted(f"{a}:{b}" for a, b in place.discards()) or ["no matches taken back"]:
            say(line)
        return
    with place.held():
        runs, pairs = _sorted_out(place, what, undo)
        if pairs:
            before = place.discards()
            place.decide(discards=before - set(pairs) if undo else before | set(pairs))
        logs = listed([*dict.fromkeys(log for run in runs if (log := place.ingested(run).log))])
        for run in runs:
            _discard_run(place, run)
        names = listed([*runs, *(f"{a}:{b}" for a, b in pairs)])
        done = f"{'counted again' if undo else 'discarded'}: {names}"
        note(place, "discard", done)
        back = "comes back when its log is" if len(runs) == 1 else "come back when their logs are"
        back += f" ingested again{logs and f', unless you remove it: {logs}'}"
        say(f"{done}; {listed(runs)} {back}" if runs else done)
        made_again(place, {*runs, *(run for pair in pairs for run in pair)})


def _sorted_out(place: Workspace, what: list[str], undo: bool) -> tuple[list[str], list[Pair]]:
    """The runs and the pairs that are named; UsageError for unknown ones, pairs locked as the same
    and where there is nothing to undo, DataError for files in place of maps."""
    known = set(place.runs())
    runs: list[str] = []
    pairs: list[Pair] = []
    for name in dict.fromkeys(what):
        pair = pair_named(name, known)
        if name in known and not undo:
            runs.append(name)
        elif pair is None or pair[0] == pair[1]:
            raise place.unknown([name], f"{'two runs A:B' if undo else 'run or runs A:B'} named")
        else:
            pairs.append(pair)
    discards = place.discards()
    same = {(lock.a, lock.b) for lock in place.locks() if lock.decision == "same"}
    for a, b in pairs:
        if undo and (a, b) not in discards:
            raise UsageError(f"the match {a}:{b} was not discarded")
        if not undo and (a, b) in same:
            first = place.call("lock", a, b, "--clear")
            raise UsageError(f"{a} and {b} are locked as the same; first: {first}")
    _, unreadable = place.read_maps(runs)
    for run, error in unreadable.items():
        # Of a damaged map the recording beside it tells that topobatch wrote it.
        if not place.map_rrd(run).is_file():
            raise DataError(f"{error}; it is left where it is")
    return runs, pairs


def _discard_run(place: Workspace, run: str) -> None:
    """Remove a run and its exports."""
    place.rename_decided({run: None})
    for ending in chain.from_iterable(ENDINGS.values()):
        (place.exports / f"{run}{ending}").unlink(missing_ok=True)
    place.remove_run(run)


@verb
def rename(
    old: Annotated[str, "OLD", "A run.", RUNS],
    new: Annotated[str, "NEW", "Its new name."],
    place: Here,
    quiet: QuietOption = False,
) -> None:
    """Give a run another name.

    In its map, in locks and in the merges. Its pieces (RUN#2 and so on) are renamed with it. Its
    log, ingested again, goes by the new name. The recording of its map shows the old name until
    then; exports stay as they are.

    \b
      topobatch rename run1 monday
    """
    from .merges import made_again

    show(quiet=quiet)
    checked_file_name(new)
    with place.held():
        names = _names(place, old, new)
        for before, after in names.items():
            _rename(place, before, after, names)
        place.rename_decided(names)
        note(place, "rename", f"{old} → {new}")
        say(f"{old} is {new} now")
        made_again(place, names, names)


def _names(place: Workspace, old: str, new: str) -> dict[str, str]:
    """New names by old ones, of a run and its pieces."""
    known = place.runs()
    place.chosen_runs([old])
    if "#" in new or PIECE.search(old):
        raise UsageError("pieces of a run are named after it (RUN#2): rename RUN, without any #")
    pieces = (run for run in known if run.startswith(old) and PIECE.fullmatch(run[len(old) :]))
    names = {run: f"{new}{run[len(old) :]}" for run in (old, *pieces)}
    taken = sorted(set(names.values()) & set(known))
    if taken:
        raise UsageError(f"there is a run {taken[0]!r} already")
    sites = place.sites()
    if (result := place.last_result()) is not None:
        sites |= {c.site: tuple(c.poses) for c in result.components}
    for before, name in names.items():
        place.check_run(name)
        if {*sites.get(name, ())} - {before}:
            raise UsageError(f"{name!r} cannot name a run: a site is called so")
    return names


def _rename(place: Workspace, old: str, new: str, names: dict[str, str]) -> None:
    """Move the files of a run; new ones are written before old ones are removed."""
    topomap = replace(place.read_map(old), run=new)
    write_map(place.map_json(new), topomap)
    if place.map_rrd(old).exists():
        place.map_rrd(old).replace(place.map_rrd(new))
    record = place.ingested(old)
    if record.log is not None:  # by which the log is known to be this run
        runs, views = (
            [names.get(run, run) for run in some] for some in (record.runs, record.views)
        )
        write_json(place.ingest_record(new), asdict(replace(record, runs=runs, views=views)))
    place.remove_run(old)


@verb
def site(
    words: Annotated[
        list[str],
        "RUN|SITE NAME ...",
        "A run of the site, or its name so far, and what to call it from now on; several such "
        "pairs, one after the other.",
        RUNS,
    ],
    place: Here,
    quiet: QuietOption = False,
) -> None:
    """Name sites: the places where runs that were merged were recorded.

    Every site has a name, which topobatch list shows: that of the folder of its logs, or what the
    names of its runs begin with, or "site-" and its oldest run. One that you give is kept
    (sites.json), as more runs come and others go. Two sites that become one keep the name that most
    runs have; of a site that comes apart, the larger part keeps it. Exports are called like their
    site. Several may be named at once: topobatch site run1 north run7 east.

    \b
      topobatch site run1 north
      topobatch export --site north --format nav2
      topobatch draw north north.svg
    """
    from .merges import made_again

    show(quiet=quiet)
    if len(words) % 2:
        raise UsageError(f"a run and a name for its site are needed; {words[-1]!r} is alone")
    with place.held():
        before = place.sites()
        try:
            lines = [_name(place, *pair) for pair in zip(words[::2], words[1::2], strict=True)]
            made_again(place, place.runs())
        except UsageError:
            place.decide(sites=before)
            raise
        for line in lines:
            note(place, "site", line)
            say(f"site {line}")
    if not place.merged_json.is_file():
        say(f"next: {place.call('merge', '--all')}")


def _name(place: Workspace, run: str, name: str) -> str:
    """Keep the name of one site; it and its runs in words."""
    components: list[list[str]] = []
    sites: dict[str, str] = {}
    if (result := place.last_result()) is not None:
        components, sites = [sorted(c.poses) for c in result.components], result.sites
    at = [runs for runs in components if run in runs or sites.get(runs[0]) == run]
    if run in place.runs():
        at = [runs for runs in at if run in runs] or [[run]]
    if not at:
        raise place.unknown([run], "run or site named")
    runs = at[0]
    _check_site(place, name, sites, runs)
    old = {sites.get(each) for each in runs} | {name}
    left = {s: [each for each in own if each not in runs] for s, own in place.sites().items()}
    kept = {site: own for site, own in left.items() if site not in old and own}
    place.decide(sites={**kept, name: runs})
    return f"{name}: {listed(runs)}"


def _check_site(place: Workspace, name: str, sites: dict[str, str], runs: list[str]) -> None:
    """UsageError if a site cannot be called so. sites: of every run."""
    checked_file_name(name, "a site")
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
