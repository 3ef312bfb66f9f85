"""The workspace folder: the path of each file, what is called how, and who works on it."""

from __future__ import annotations

import os
import shlex
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from filelock import FileLock, Timeout
from pydantic import ValidationError

from ..merge.document import read_merged, result_from_document
from ..merge.locks import (
    Lock,
    discards_from_document,
    discards_to_document,
    locks_from_document,
    locks_to_document,
)
from ..merge.merged_schema import MergedDocument, is_site_name
from ..merge.result import MergeResult
from ..merge.sites import sites_from_document, sites_to_document
from ..topology.document import read_map
from ..topology.errors import DataError, DocumentError, UsageError
from ..topology.files import LEFT_OVER, kind_of, read_json, write_json
from ..topology.map_schema import with_way_out
from ..topology.topomap import TopoMap
from ..topology.wording import listed
from .ingest_record import RECORD, IngestRecord
from .output import warn

T = TypeVar("T")

RUN, MERGE = "a run", "a merge"
"""What is named."""

MERGED = "merged"
"""Default name of a merge."""

USUAL = Path("topobatch-workspace")
"""The folder where none is named."""

FOLDERS = ("maps", "exports", "cache", "cache/ingest")
FILES = (".lock", "cache/kept.sqlite", "cache/kept.sqlite-journal")
"""What the program opens or clears without looking."""

DECISIONS = ("locks", "discards", "sites")
"""Names of the documents of what a person decided."""


@dataclass(frozen=True, slots=True)
class Workspace:
    """The folder of the command's results: `maps/<run>.json`, `maps/<run>.views`, `maps/<run>.rrd`,
    `merged.json`, `merged.rrd`, `locks.json`, `discards.json`, `sites.json`, `history.jsonl`,
    `cache/`.

    Its contents are untrusted. Raises DataError if one of its folders is a link or no folder, so
    that nothing is written or removed elsewhere. Names must be plain file names, else UsageError.

    root: a path or its text; merge: name of the merge, if not the default.
    """

    root: Path
    merge: str = MERGED

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", Path(self.root))
        for names, kind, word in (
            (FOLDERS, stat.S_IFDIR, "folder"), (FILES, stat.S_IFREG, "file"),
        ):  # fmt: skip
            for path in map(self.root.joinpath, names):
                if os.path.lexists(path) and stat.S_IFMT(os.lstat(path).st_mode) != kind:
                    kept = f"where topobatch keeps a {word} of its own"
                    raise DataError(f"{path}: is a {kind_of(path)}, {kept}; remove it")

    # Paths

    @property
    def maps(self) -> Path:
        """Folder of the runs' maps."""
        return self.root / "maps"

    @property
    def exports(self) -> Path:
        """Folder of exported maps."""
        return self.root / "exports"

    @property
    def merged_json(self) -> Path:
        """The merged document."""
        return self.root / f"{plain_name(self.merge, MERGE)}.json"

    @property
    def merged_rrd(self) -> Path:
        """The merged recording."""
        return self.merged_json.with_name(f"{self.merge}.rrd")

    @property
    def kept(self) -> Path:
        """The database of results of merging; may be deleted at any time."""
        return self.root / "cache" / "kept.sqlite"

    @property
    def settings_toml(self) -> Path:
        """Options that its commands take by default."""
        return self.root / "settings.toml"

    @property
    def history(self) -> Path:
        """What was done to the workspace."""
        return self.root / "history.jsonl"

    def map_json(self, run: str) -> Path:
        """The map document of a run."""
        return self.maps / f"{plain_name(run)}.json"

    def map_views(self, run: str) -> Path:
        """The views of a run's map, if it has any."""
        return self.maps / f"{plain_name(run)}.views"

    def map_rrd(self, run: str) -> Path:
        """The recording of a run."""
        return self.maps / f"{plain_name(run)}.rrd"

    def ingest_record(self, run: str) -> Path:
        """The record of how a run's map was made; may be deleted at any time."""
        return self.root / "cache" / "ingest" / f"{plain_name(run)}.json"

    def remove_run(self, run: str) -> None:
        """Remove the files of a run, its map last, so that an interrupted call can be repeated."""
        made = (self.map_rrd(run), self.map_views(run), self.map_json(run))
        for path in (self.ingest_record(run), *made):
            path.unlink(missing_ok=True)

    # Calls of the command, for messages

    def call(self, *words: str) -> str:
        """A call of topobatch on this workspace, as a shell takes it."""
        return shlex.join(("topobatch", *words, *self.where))

    @property
    def where(self) -> tuple[str, ...]:
        """The options that name this workspace in a call."""
        usual = Path(os.environ.get("TOPOBATCH_WORKSPACE") or USUAL)
        return () if self.root == usual else ("-w", str(self.root))

    @property
    def of_merge(self) -> tuple[str, ...]:
        """The options that name this merge in a call of what reads one."""
        return () if self.merge == MERGED else ("--merge", self.merge)

    # Names

    def runs(self) -> list[str]:
        """Names of the runs that have a map, sorted."""
        return sorted(p.stem for p in self.maps.glob("*.json") if not p.name.startswith("."))

    def chosen_runs(self, names: Sequence[str], everything: bool = False) -> list[str]:
        """The runs that a command is about; UsageError or DataError where there are none."""
        known = self.runs()
        if not known:
            raise self.no_maps()
        if everything and names:
            raise UsageError("give run names or --all, not both")
        if everything:
            return known
        if not names:
            raise UsageError("name the runs, or use --all for every run in the workspace")
        unknown = sorted(set(names) - set(known))
        if unknown:
            raise self.unknown(unknown)
        return sorted(set(names))

    def merge_named(self, name: str) -> Workspace | None:
        """This workspace with the merge that is called so; None where there is none."""
        try:
            named = Workspace(self.root, name)
            return named if named.merged_json.is_file() else None
        except UsageError:  # no name that a merge could have
            return None

    def named(self, what: str) -> Named:
        """What a name stands for; UsageError or DataError if it is none."""
        runs = self.runs()
        if what in runs and what != MERGED:
            return Named(self, run=what)
        if pair := pair_named(what, runs):
            if pair[0] == pair[1]:
                raise UsageError(f"two runs are needed, got {pair[0]!r} twice")
            return Named(self, pair=pair)
        merge = self if what == MERGED else self.merge_named(what)
        if merge is not None:
            return Named(merge)
        if (result := self.last_result()) and what in result.sites.values():
            return Named(self, site=what)
        raise self.unknown([what], "run, site, merge or pair A:B named")

    def merges(self) -> list[Workspace]:
        """This workspace with each of its merges, the one with the default name first."""
        usual = Workspace(self.root)
        others = {MERGED, *DECISIONS}
        named = sorted({path.stem for path in self.root.glob("*.json")} - others)
        # A document without a recording beside it is none of topobatch's.
        written = [m for m in map(self.merge_named, named) if m and m.merged_rrd.is_file()]
        return [usual, *written] if os.path.lexists(usual.merged_json) else written

    def check_merge(self) -> None:
        """UsageError if the name of the merge is too long, or used for something else."""
        checked_file_name(self.merge, MERGE)
        if self.merge.casefold() == MERGED:
            raise UsageError(f"{self.merge!r} cannot name a merge: that is one without --output")
        if self.merge.casefold() in (*DECISIONS, *FOLDERS) or self.merge in self.runs():
            raise UsageError(f"{self.merge!r} cannot name a merge: something else is called so")

    def check_run(self, run: str) -> None:
        """UsageError if a run cannot have a name: it is no file name, or that of a merge."""
        merge = self.root / f"{checked_file_name(run)}.json"
        if run.casefold() == MERGED or (run not in DECISIONS and os.path.lexists(merge)):
            raise UsageError(f"{run!r} cannot name a run: a merge is called so")

    def component(
        self, result: MergeResult, site: str | None, number: int | None = None
    ) -> int | None:
        """The component that is a site or that of a run, or has a number; None if neither is given.
        UsageError if there is none, or both are given."""
        if site is not None and number is not None:
            raise UsageError("name a site or a --component, not both")
        ids = {c.name: c.id for c in result.components}
        if site is None and number in (None, *ids.values()):
            return number
        if site in result.home and site not in ids:
            return result.home[site]
        if site is None or site not in ids:
            named = f"component {number}" if site is None else f"site {site!r}"
            raise UsageError(
                f"{self.merged_json}: there is no {named}{_meant(site or '', [*ids])} there are: "
                f"{listed(sorted(ids)) or 'none'}"
            )
        return ids[site]

    # What to say where something is missing

    def unknown(self, names: Sequence[str], what: str = "map of") -> UsageError | DataError:
        """What to say where runs are named that there are not."""
        known = self.runs()
        if not known:
            return self.no_maps()
        if "site" in what and (result := self.last_result()):
            known = sorted({*result.sites.values()} - {*known}) + known
        strange = [part for part in ":".join(names).split(":") if part not in known]
        meant = _meant(strange[0], known) if strange else ";"
        return UsageError(
            f"no {what} {listed(names)} in {self.root}{meant} there are: {listed(known)}"
        )

    def no_maps(self) -> DataError:
        """What to say of a workspace without maps, or of none."""
        what = "holds no maps yet" if self.root.is_dir() else "there is no such workspace"
        return DataError(
            f"{self.root}: {what}; make maps with `topobatch ingest LOG…`, or name another "
            "--workspace"
        )

    def require(self) -> None:
        """DataError where there is no such folder."""
        if not self.root.is_dir():
            raise self.no_maps()

    def require_merge(self) -> None:
        """DataError where nothing was merged yet, UsageError where nothing of a given name was."""
        if self.merged_json.is_file():
            return
        if self.merge != MERGED:
            how = f"`topobatch merge … --output {self.merge}` makes it"
            if self.merge in self.runs():
                how = "that is a run; --merge takes the --output NAME of a merge"
            raise UsageError(f"{self.merged_json}: is not there; {how}")
        if not self.runs():
            raise self.no_maps()
        how = self.call("merge", "--all")
        raise DataError(f"{self.merged_json}: is not there yet; make it with `{how}`")

    # Documents

    def ingested(self, run: str) -> IngestRecord:
        """The record of the log that a run's map was made from; an empty one if there is none."""
        try:
            return RECORD.validate_python(read_json(self.ingest_record(run)))
        except (DocumentError, UsageError, ValidationError):
            # A cache: without it a log is just read again. No run of ours has a name that is none.
            return IngestRecord()

    def ingest_records(self) -> dict[str, IngestRecord]:
        """The records of all runs, without those of further pieces, by run."""
        runs = sorted(path.stem for path in self.root.joinpath("cache/ingest").glob("*.json"))
        records = {run: self.ingested(run) for run in runs}
        return {run: record for run, record in records.items() if record.runs[:1] == [run]}

    def read_map(self, run: str) -> TopoMap:
        """The map of a run; DocumentError with the way out if it cannot be read, or is another
        run's."""
        try:
            path = self.map_json(run)
        except UsageError as error:  # a name that a file has, but that nothing of ours gave it
            raise DocumentError(f"{self.maps}: {error}") from error
        try:
            topomap = read_map(path)
            if topomap.run != run:
                raise DocumentError(f"{path}: is the map of run {topomap.run!r}, not {run!r}")
        except DocumentError as error:
            raise with_way_out(error, "map") from error
        return topomap

    def read_maps(self, runs: Iterable[str]) -> tuple[dict[str, TopoMap], dict[str, DocumentError]]:
        """The maps of runs that can be read, and why the others cannot."""
        maps: dict[str, TopoMap] = {}
        errors: dict[str, DocumentError] = {}
        for run in runs:
            try:
                maps[run] = self.read_map(run)
            except DocumentError as error:
                errors[run] = error
        return maps, errors

    def maps_as_merged(
        self, result: MergeResult, component: int, runs: Sequence[str]
    ) -> dict[str, TopoMap]:
        """The maps of runs of a component; DataError where one is not that which was merged."""
        from ..merge.component_map import stale_runs  # loads scipy

        maps = {run: self.read_map(run) for run in runs}
        stale = stale_runs(result, component, maps)
        changed = [f"{run} {stale[run]}" for run in runs if run in stale]
        if changed:
            raise DataError(
                f"{self.maps}: not all maps are those that were merged ({listed(changed, 3)}); "
                "merge again"
            )
        return maps

    def read_merged(self) -> MergedDocument:
        """The merged document; as `require_merge`, and DocumentError with the way out if it is
        none."""
        self.require_merge()
        try:
            return read_merged(self.merged_json)
        except DocumentError as error:
            raise with_way_out(error, "merged", self.call("merge", "--all")) from error

    def read_result(self) -> MergeResult:
        """The merge from its document; as `read_merged`."""
        document = self.read_merged()
        with self.document_at_fault():
            return result_from_document(document)

    def last_result(self) -> MergeResult | None:
        """The merge, as `read_result`; None where nothing was merged yet."""
        return self.read_result() if self.merged_json.is_file() else None

    @contextmanager
    def document_at_fault(self, part: str = "") -> Iterator[None]:
        """Say of a ValueError that what the merged document states, or a part, cannot be."""
        try:
            yield
        except ValueError as error:
            raise DocumentError(f"{self.merged_json}: {part}{error}") from error

    # What a person decided; DocumentError if that cannot be read

    def locks(self) -> tuple[Lock, ...]:
        """Decisions about pairs of runs."""
        return self._decided("locks", locks_from_document, ())

    def discards(self) -> frozenset[tuple[str, str]]:
        """Pairs of runs whose match was taken back."""
        return self._decided("discards", discards_from_document, frozenset())

    def sites(self) -> dict[str, tuple[str, ...]]:
        """Names that were given to sites, with their runs."""
        return self._decided("sites", sites_from_document, {})

    def _decided(self, name: str, from_document: Callable[[Any, str], T], none: T) -> T:
        path = self.root / f"{name}.json"
        return from_document(read_json(path), str(path)) if os.path.lexists(path) else none

    def decide(
        self,
        *,
        locks: Sequence[Lock] | None = None,
        discards: Collection[tuple[str, str]] | None = None,
        sites: Mapping[str, Iterable[str]] | None = None,
    ) -> None:
        """Keep what is given in place of what was; nothing decided leaves no document."""
        documents = {
            "locks": locks and locks_to_document(locks),
            "discards": discards and discards_to_document(discards),
            "sites": sites and sites_to_document(sites),
        }
        for name, document in documents.items():
            path = self.root / f"{name}.json"
            if document:
                write_json(path, document)
            elif document is not None:
                path.unlink(missing_ok=True)

    def rename_decided(self, names: Mapping[str, str | None]) -> None:
        """Give runs new names in what a person decided; what is about a run that gets None goes."""

        def renamed(*runs: str) -> list[str]:
            return [new for run in runs if (new := names.get(run, run)) is not None]

        locks = [(lock, renamed(lock.a, lock.b)) for lock in self.locks()]
        pairs = [renamed(*pair) for pair in self.discards()]
        self.decide(
            locks=[replace(lock, a=new[0], b=new[1]) for lock, new in locks if len(new) == 2],
            discards=[(min(pair), max(pair)) for pair in pairs if len(pair) == 2],
            sites={site: renamed(*runs) for site, runs in self.sites().items()},
        )

    # Who works on it

    @contextmanager
    def held(self, *, make: bool = False) -> Iterator[None]:
        """Keep other topobatch processes out of the workspace, waiting for them if need be.

        What a killed process left half-written is cleared away. A workspace that is not there yet
        is a DataError or, if told so, made.
        """
        if not make:
            self.require()
        lock = FileLock(self.root / ".lock")
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            lock.acquire(blocking=False)
        except Timeout:
            warn(f"{self.root}: another topobatch is at work there; waiting for it")
            lock.acquire()
        except OSError as error:
            raise DataError(
                f"{self.root}: cannot be written ({error.strerror}); name another --workspace"
            ) from error
        try:
            for path in chain(
                *(self.root.joinpath(each).glob(".*.tmp") for each in ("", *FOLDERS))
            ):
                if LEFT_OVER.fullmatch(path.name) and path.is_file() and not path.is_symlink():
                    path.unlink(missing_ok=True)
            yield
        finally:
            lock.release()


@dataclass(frozen=True, slots=True)
class Named:
    """A run, a pair of runs, a site, or without any the merge of a workspace."""

    place: Workspace
    run: str | None = None
    pair: tuple[str, str] | None = None
    site: str | None = None


def _meant(name: str, known: Sequence[str]) -> str:
    """The known name that is nearest to an unknown one, as a question."""
    near = get_close_matches(Path(name).name, known, 1)
    return f"; did you mean {near[0]}?" if near else ";"


def pair_named(text: str, runs: Iterable[str]) -> tuple[str, str] | None:
    """The pair of known runs that "A:B" names, in the order of names."""
    pair = text.split(":")
    if len(pair) != 2 or not set(runs).issuperset(pair):
        return None
    return min(pair), max(pair)


def checked_file_name(name: str, what: str = RUN) -> str:
    """A name for a new `what`, which has to work as a file name, without the colon between the
    names of a pair; else a UsageError."""
    if not is_site_name(name):
        raise UsageError(
            f"{name[:40]!r} cannot name {what}: it must work as a file name, of at most 200 bytes "
            "and without a colon"
        )
    return name


def plain_name(name: str, what: str = RUN) -> str:
    """A name that stays in the folder that it is put in, or a UsageError."""
    plain = name.isprintable() and not name.startswith(".") and name == Path(name).name
    if not name or not plain:
        raise UsageError(f"{name!r} cannot name {what}: it must work as a file name")
    return name
