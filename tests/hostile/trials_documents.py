"""Hostile documents, caches and tables: what lies in a workspace may come from anybody."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from judge import left_overs, parsed
from sandbox import Budget, command, run
from trials import Ground, Trial, Tried, Victim, copied, ingest, judged, merge

BUDGET = Budget(cpu_s=20, memory_mb=300)

EVIL = "\x1b]0;evil\x07\x1b[2J\nerror: \u202e\x9b"
TEXTS = ("", "..", "../../victim/x", "/etc/passwd", "a\0b", "\ud800", EVIL, "x" * 100_000, "#2")
NUMBERS = (0, -1, 1e-300, 1e308, -1e9, 2**31, 2**63, 2**64, 10**30, 0.5, 999e3)
FORMATS = ("nav2", "lif", "rmf", "tmap2", "graphml", "g2o", "tum", "csv")
OTHERS = (None, True, False, [], {}, [[]], {"": None})


def _deep(levels: int) -> Any:
    value: Any = 0
    for _ in range(levels):
        value = [value]
    return value


def _spot(doc: Any, rng: random.Random) -> tuple[Any, Any]:
    """A container somewhere in a document and a key of it; deep ones as likely as shallow ones."""
    here, key = doc, None
    depth = rng.randrange(1, 8)
    for _ in range(depth):
        keys = list(here) if isinstance(here, dict) else list(range(len(here)))
        if not keys:
            break
        key = rng.choice(keys)
        if not isinstance(here[key], dict | list) or not here[key] or rng.random() < 0.15:
            return here, key
        above, here = here, here[key]
        last = above, key
    return last if key is not None and depth > 1 else (doc, next(iter(doc)))


def mutated(doc: Any, rng: random.Random) -> Any:
    """A document with a few values that nobody would write."""
    for _ in range(rng.randrange(1, 4)):
        here, key = _spot(doc, rng)
        match rng.randrange(9):
            case 0 | 1:
                here[key] = rng.choice(NUMBERS)
            case 2 | 3:
                here[key] = rng.choice(TEXTS)
            case 4:
                here[key] = rng.choice(OTHERS)
            case 5:
                del here[key]
            case 6:
                here[key] = _deep(rng.choice((3, 150, 900)))
            case 7 if isinstance(here, list):
                here += [here[key]] * rng.choice((1, 100, 20_000))
            case 8 if isinstance(here, dict):
                here[rng.choice(TEXTS[:-2])] = here[key]
        if not doc:
            break
    return doc


def spoilt(raw: bytes, rng: random.Random) -> bytes:
    """The text of a document, broken as text."""
    at = rng.randrange(len(raw))
    other = rng.randbytes(1)
    return rng.choice(
        [
            raw[:at],
            raw[:at] + other + raw[at + 1 :],
            b"[" * 100_000 + raw,
            b'{"a":' * 100_000,
            raw.replace(b":0.", b":NaN,0.", 1),
            raw.replace(b":0.", b":NaN", 1),
            raw + raw,
            raw[:at] + b"9" * 10_000 + raw[at:],
            rng.randbytes(rng.randrange(2000)),
        ]
    )


def _names(doc: Any, rng: random.Random) -> Any:
    """Control characters in every text but the run's name and the words of the schema."""
    kept = {"junction", "dead_end", "bend", doc.get("schema"), doc["graph"].get("run")}

    def spelt(value: Any) -> Any:
        if isinstance(value, str):
            return value if value in kept else value + EVIL
        if isinstance(value, list):
            return [spelt(v) for v in value]
        return {k: spelt(v) for k, v in value.items()} if isinstance(value, dict) else value

    return spelt(doc)


def _written(path: Path, rng: random.Random) -> str:
    """Put something hostile in the place of a document; says what."""
    raw = path.read_bytes()
    how = rng.random()
    if how < 0.3:
        path.write_bytes(spoilt(raw, rng))
        return "text"
    change: Callable[[Any, random.Random], Any] = mutated
    if path.parent.name == "maps" and how < 0.45:
        change = _names
    path.write_text(json.dumps(change(json.loads(raw), rng)), encoding="utf-8")
    return change.__name__


def _calls(workspace: Path, ground: Ground, rng: random.Random) -> tuple[str, Callable[[], None]]:
    return rng.choice(
        [
            ("merge", merge(workspace)),
            ("merge", merge(workspace)),
            ("explain", command(["explain", "a", "b", "-w", workspace])),
            ("lock", command(["lock", "-w", workspace])),
            ("list", command(["list", "-w", workspace])),
            ("history", command(["history", "-w", workspace])),
            ("discard", command(["discard", "a", "-w", workspace])),
            ("rename", command(["rename", "a", "z", "-w", workspace])),
            ("ingest", ingest(workspace, ground.logs)),
            ("export", command(["export", "merged", "-f", rng.choice(FORMATS), "-w", workspace])),
            ("export", command(["export", "a", "-f", rng.choice(FORMATS), "-w", workspace])),
            ("changes", command(["changes", "--all", "-w", workspace])),
        ]
    )


def document(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """One document of a workspace is hostile; the others are not lost for it."""
    workspace, victim = copied(ground, folder), Victim(folder / "victim")
    (workspace / "locks.json").write_text(
        '{"schema":"topobatch.locks/1","locks":[{"a":"b","b":"c","decision":"same","at":[0,0]}]}'
    )
    (workspace / "discards.json").write_text(
        '{"schema":"topobatch.discards/1","discarded":[{"a":"a","b":"c"}]}'
    )
    (workspace / "history.jsonl").write_text('{"time":"now","what":"merge","text":"a"}\n')
    places = [workspace / "maps" / "a.json"] * 3 + [
        workspace / "merged.json",
        workspace / "locks.json",
        workspace / "cache" / "ingest" / "a.json",
        workspace / "discards.json",
        workspace / "history.jsonl",
    ]
    place = rng.choice(places)
    how = _written(place, rng)
    name, call = _calls(workspace, ground, rng)
    outcome = run(call, folder, BUDGET)
    lost = ""
    if name == "merge" and place.stem == "a" and outcome.code != 2:
        text = (workspace / "merged.json").read_text()
        lost = "" if '"b"' in text and '"c"' in text else "the other maps were lost"
    note = f"{place.name}: {how}; {name}"
    return judged(
        [outcome], note, lost, victim.touched(), left_overs(workspace), parsed_of(place, workspace)
    )


def parsed_of(spoilt_place: Path, workspace: Path) -> str:
    """What we wrote ourselves must be JSON; what was spoilt may have stayed so."""
    return (
        ""
        if spoilt_place.name == "merged.json" or "cache" in spoilt_place.parts
        else parsed(workspace)
    )


def _put(place: Path, victim: Path, rng: random.Random) -> str:
    """Something that is no file in the place of one."""
    if place.is_dir() and not place.is_symlink():
        os.rename(place, place.with_name(place.name + "-away"))
    else:
        place.unlink(missing_ok=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    kind = rng.choice(("link", "link to a folder", "link to itself", "FIFO", "folder", "device"))
    match kind:
        case "link":
            place.symlink_to(victim / "precious")
        case "link to a folder":
            place.symlink_to(victim)
        case "link to itself":
            place.symlink_to(place.name)
        case "FIFO":
            os.mkfifo(place)
        case "folder":
            (place / "more").mkdir(parents=True)
        case "device":
            place.symlink_to("/dev/zero")
    return kind


def not_a_file(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """Links, FIFOs, devices and folders where documents, folders or left-overs should be."""
    workspace, victim = copied(ground, folder), Victim(folder / "victim")
    names = (
        *("maps/a.json", "maps/a.rrd", "maps/bad.json", "maps", "merged.json", "merged.rrd"),
        *("locks.json", "cache", "cache/ingest", "cache/ingest/a.json", ".lock", "explain"),
        *("cache/pairs", f"cache/pairs/{'0' * 32}.pack", "discards.json", "history.jsonl"),
        *("exports", "exports/a.geojson", "exports/merged.geojson"),
        *("maps/.topobatch-abcdefgh.tmp", ".x.tmp", "explain/a+b.rrd"),
    )
    notes = []
    for name in rng.sample(names, rng.randrange(1, 3)):
        above = list((workspace / name).parents)[: name.count("/") + 1]
        if all(p.is_dir() and not p.is_symlink() for p in above if os.path.lexists(p)):
            notes.append(f"{name}: {_put(workspace / name, victim.folder, rng)}")
    name, call = _calls(workspace, ground, rng)
    outcome = run(call, folder, BUDGET)
    return judged([outcome], f"{'; '.join(notes)}; {name}", victim.touched())


# Tables of places for `transfer`

GOOD = "name,x,y,theta\ndock,1,2,0.5\n"
ODD = ("nan", "inf", "1e400", "-1e308", "1_0", "٣", "0x1", "", " 1 ", "1,5", "9" * 5000, "1e-320")


def _numbers(rng: random.Random) -> str:
    count = rng.choice((1, 50))
    rows = [f"p{k},{','.join(rng.choices(ODD, k=3))}\n" for k in range(count)]
    return "name,x,y,theta\n" + "".join(rows)


def _words(rng: random.Random) -> str:
    name = rng.choice((EVIL, "x" * 100_000, "=cmd()", "\0", "", "a\rb", '"a\nb"'))
    return f"{GOOD}{name},1,2,0\n"


def _rows(rng: random.Random) -> str:
    return "name,x,y\n" + "p,1.5,2.5\n" * rng.choice((50_000, 10**6))


def _text(rng: random.Random) -> str:
    return rng.choice(("\ufeff" + GOOD, GOOD.replace("\n", "\r"), GOOD * 3, "\n" * 10**6, EVIL))


def _bytes(rng: random.Random) -> bytes:
    raws = (b"\xff\xfe" + GOOD.encode("utf-16-le"), b"\xed\xa0\x80" + GOOD.encode(), bytes(10**6))
    return rng.choice((*raws, rng.randbytes(5000), b"", GOOD.encode() + b"a\0b,1,2,0\n"))


TABLES = (_numbers, _words, _rows, _text, _bytes)


def places(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """A table of places that nobody wrote: an error that names its line, or a note in its row."""
    workspace, table = copied(ground, folder), folder / "places.csv"
    make = rng.choice(TABLES)
    how, raw = make.__name__, make(rng)
    if rng.random() < 0.1:
        table.symlink_to(rng.choice(("/dev/zero", "places.csv", "/proc/self/mem")))
        how = "a link"
    else:
        table.write_bytes(raw.encode() if isinstance(raw, str) else raw)
    target = rng.choice(("b", "c", "merged", EVIL))
    within = rng.choice(("0.5", "1000", "nan", "-1", "inf"))
    call = ["transfer", table, "--from", "a", "--to", target, "--within", within]
    outcome = run(command([*call, "-o", folder / "out.csv", "-w", workspace]), folder, BUDGET)
    made = (folder / "out.csv").exists()
    whole = "" if outcome.code != 0 or made else "nothing was written"
    return judged([outcome], f"{how}, to {target!r}", whole, left_overs(folder))


TRIALS: dict[str, Trial] = {
    "hostile documents": document,
    "no file where one should be": not_a_file,
    "tables of places": places,
}
"""By class."""
