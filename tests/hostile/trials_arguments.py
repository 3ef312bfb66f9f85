"""Hostile arguments: tables of places for `transfer`, mappings for `--junction-fields`."""

from __future__ import annotations

import random
from pathlib import Path

from case import writers
from judge import left_overs
from sandbox import Budget, command, run
from trials import Ground, Trial, Tried, copied, judged

BUDGET = Budget(cpu_s=20, memory_mb=300)
EVIL = "\x1b]0;evil\x07\x1b[31m\u202e\x9b"


GOOD = "name,x,y,theta\ndock,1,2,0.5\n"
ODD = ("nan", "inf", "1e400", "-1e308", "1_0", "٣", "0x1", "", " 1 ", "1,5", "9" * 5000, "1e-320")


def _numbers(rng: random.Random) -> str:
    count = rng.choice((1, 50))
    rows = [f"p{k},{','.join(rng.choices(ODD, k=3))}\n" for k in range(count)]
    return "name,x,y,theta\n" + "".join(rows)


def _names(rng: random.Random) -> str:
    name = rng.choice((EVIL, "x" * 100_000, "=cmd()", "\0", "", "a\rb", '"a\nb"'))
    return f"{GOOD}{name},1,2,0\n"


def _rows(rng: random.Random) -> str:
    return "name,x,y\n" + "p,1.5,2.5\n" * rng.choice((50_000, 10**6))


def _columns(rng: random.Random) -> str:
    head = rng.choice(("x,y", "name,x", "name,x,y,x", "", "name,x,y,note", ",,,", "name;x;y"))
    return f"{head}\na,1,2,3\n"


def _wide(rng: random.Random) -> str:
    count = rng.choice((1000, 100_000))
    more = ",".join(f"c{k}" for k in range(count))
    row = "p,1,2" + "," * count + "\n"
    return f"name,x,y,{more}\n" + row * rng.choice((1, 15 * 2**20 // len(row)))


def _quotes(rng: random.Random) -> str:
    body = rng.choice(('"', '"a""', '"' + "x" * 200_000, "a" + '"' * 1001))
    return f"name,x,y\n{body},1,2\n"


def _text(rng: random.Random) -> str:
    return rng.choice(("\ufeff" + GOOD, GOOD.replace("\n", "\r"), GOOD * 3, "\n" * 10**6, EVIL))


def _bytes(rng: random.Random) -> bytes:
    raws = (b"\xff\xfe" + GOOD.encode("utf-16-le"), b"\xed\xa0\x80" + GOOD.encode(), bytes(10**6))
    return rng.choice((*raws, rng.randbytes(5000), b"", GOOD.encode() + b"a\0b,1,2,0\n"))


TABLES = (_numbers, _names, _rows, _columns, _wide, _quotes, _text, _bytes)


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


PATHS = ("poses[]", "poses", "header.frame_id", "pose.position", "a", "poses[].position.x", "data")
KEYS = ("center", "centre", "branches", "each", "stamp", "frame", "unit", "length", "x")


def _mapping(rng: random.Random) -> str:
    odd = (
        "a." * 100_000 + "b",
        "a[]." * 5000 + "b",
        "[]" * 10_000,
        "x" * 10**6,
        EVIL,
        "__class__.__init__.__globals__",
        "\0",
        "\udcff",
        "a..b",
        ".",
        "",
        "=",
        "{}",
        "%s%s",
        "µ.ª",
        "header." * 3 + "header",
        "poses[]." * 100 + "position",
    )
    parts = [
        f"{rng.choice(KEYS)}={rng.choice(odd if rng.random() < 0.4 else PATHS)}"
        for _ in range(rng.choice((1, 2, 3, 5, 20)))
    ]
    if rng.random() < 0.5:
        parts = [
            f"center={rng.choice(PATHS)}",
            f"branches={rng.choice((*odd, *PATHS))}",
            *parts[:1],
        ]
    return rng.choice((",".join(parts), ",".join(parts), ",".join(parts), "," * 10**5, ""))


def fields(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """A mapping of fields that nobody meant, for a sound log."""
    logs, mapping = writers(), _mapping(rng)
    encoding = rng.choice(("cdr", "json", "protobuf"))
    log = logs.mcap(folder / "run.mcap", logs.drive(60), encoding)
    topic = rng.choice(("/junctions", "/odom", "/none"))
    call = ["ingest", log, "-w", folder / "ws", "-j", "1", "--junction-topic", topic]
    outcome = run(command([*call, "--junction-fields", mapping]), folder, BUDGET)
    return judged([outcome], f"{encoding}: {mapping[:60]!r}", left_overs(folder))


TRIALS: dict[str, Trial] = {
    "tables of places": places,
    "mappings of fields": fields,
}
"""By class."""
