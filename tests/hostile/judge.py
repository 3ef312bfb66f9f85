"""What every call has to keep to, whatever it was given: the criteria of the attack."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable
from pathlib import Path

from sandbox import Outcome

EXIT_CODES = (0, 1, 2)
LEFT_OVER = re.compile(r"\.topobatch-\w{8}\.tmp")
UNDECODED = re.compile(r"(\d+) messages? (?:could not be decoded|holds? no pose)")


def conduct(outcome: Outcome) -> str:
    """What is wrong with how a call ended and what it showed, "" if nothing is."""
    if outcome.over:
        return outcome.over
    if outcome.code not in EXIT_CODES:
        return f"exit {outcome.code}: {_last(outcome.err)}"
    return _shown(outcome.out + outcome.err) or _told(outcome)


def _shown(text: str) -> str:
    if "Traceback" in text or "internal error" in text:
        return f"internal error: {_last(text)}"
    odd = next((c for c in text if not c.isprintable() and c != "\n"), None)
    return "" if odd is None else f"{odd!r} reaches the terminal"


def _told(outcome: Outcome) -> str:
    """Errors and warnings take one line each, and no failure goes without."""
    lines = outcome.err.splitlines()
    problems = [line for line in outcome.out.splitlines() if line.startswith("problem: ")]  # info
    if outcome.code == 1 and not problems and not any(x.startswith("error: ") for x in lines):
        return f"exit 1 without an error: {_last(outcome.err)}"
    if outcome.code == 2:
        return ""  # usage takes several lines
    other = next((x for x in lines if not x.startswith(("error: ", "warning: "))), None)
    return "" if other is None else f"neither an error nor a warning: {other[:200]}"


def _last(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1][:300] if lines else "nothing was said"


def print_of(folder: Path) -> str:
    """A checksum of all names, kinds and contents below a folder."""
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(folder.rglob("*")):
        digest.update(repr(path.relative_to(folder)).encode("utf-8", "surrogateescape"))
        if path.is_symlink():
            digest.update(repr(path.readlink()).encode("utf-8", "surrogateescape"))
        elif path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def left_overs(folder: Path) -> str:
    """Names of half-written files that stayed, "" if none did."""
    names = [p.name for p in folder.rglob(".*") if LEFT_OVER.fullmatch(p.name) and p.is_file()]
    return f"left over: {', '.join(names)}" if names else ""


def halves(workspace: Path) -> str:
    """Runs of which only half is there, "" if there are none."""
    found: dict[str, set[str]] = {}
    for path in (workspace / "maps").glob("[!.]*.*"):
        found.setdefault(path.stem, set()).add(path.suffix)
    whole = {".json", ".rrd"}, {".json", ".rrd", ".views"}
    half = [name for name, suffixes in found.items() if suffixes not in whole]
    return f"half a run: {', '.join(half)}" if half else ""


def parsed(workspace: Path) -> str:
    """What of our own documents in a workspace is no JSON, "" if all is."""
    for path in [*workspace.glob("merged.json"), *(workspace / "cache").rglob("*.json")]:
        if path.is_file() and not path.is_symlink():
            try:
                json.loads(path.read_bytes())
            except (ValueError, RecursionError):
                return f"{path.name} is no JSON"
    return ""


def counts(found: int, warnings: Iterable[str], intact: int | None, lost: int | None) -> str:
    """What is wrong with the messages used and told to be lost, against the truth.

    found: messages met. At least 99 % of what is intact must be used; of what is lost there must be
    a word.
    """
    told = list(warnings)
    undecoded = sum(int(match[1]) for text in told for match in UNDECODED.finditer(text))
    if intact is not None and found - undecoded < 0.99 * intact:
        return f"{found - undecoded} of {intact} intact messages used: {'; '.join(told)[:300]}"
    if intact is None or lost is None:
        return ""
    missing = intact + lost - found
    if missing > 0 and not told:
        return f"silent loss: {missing} of {intact + lost} messages"
    return f"{-missing} messages more than were written" if missing < 0 else ""
