"""docs/recordings.md: its queries run, and its tables name what recordings hold."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

ROOT = Path(__file__).parents[2]
DOC = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")


def test_its_queries_answer_as_shown(samples, monkeypatch, capsys) -> None:
    monkeypatch.chdir(samples)
    blocks = re.findall(r"```(python|text)\n(.*?)```", DOC, re.DOTALL)
    assert [kind for kind, _ in blocks] == ["python", "text"]
    names: dict[str, object] = {}
    for (_, code), (_, shown) in zip(blocks[::2], blocks[1::2], strict=True):
        exec(code, names)
        assert capsys.readouterr().out == shown


def documented(section: str, of_scans: bool = False) -> dict[str, set[str]]:
    """Entities of the tables of a section, as patterns, with the components told of each.

    of_scans: with what only maps made from scans have.
    """
    table = DOC.partition(f"## {section}\n")[2].partition("\n## ")[0]
    found: dict[str, set[str]] = {}
    before: set[str] = set()
    for line in re.findall(r"^\|( `/.*)\|$", table, re.MULTILINE):
        entities, _, told = (cell.strip() for cell in line.split("|"))
        told_names = set(re.findall(r"`(\w+)`", told))
        before = before if told == "the same" else told_names
        for entity in re.findall(r"`(/[^`]*)`", entities):
            if of_scans or not entity.startswith("/map/scans/"):
                found[entity] = before
    return found


def pattern(entity: str) -> re.Pattern[str]:
    words = re.escape(entity).replace("component_N", r"component_\d+").replace("…", ".*")
    return re.compile(re.sub(r"\b(RUN|A|B)\b", r"[^/]+", words))


RECORDINGS = pytest.mark.parametrize(
    ("section", "file", "of_scans"),
    [
        ("A run", "maps/maze-1.rrd", False),
        ("A run", "maps/office-1.rrd", True),
        ("A merge", "merged.rrd", False),
    ],
)


def contents(path: Path) -> dict[str, set[str]]:
    """Entities with those of their components that are not the viewer's."""
    found: dict[str, set[str]] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.entity_path.startswith("/__"):
            entity = chunk.entity_path.replace("\\", "")
            names = chunk.to_record_batch().schema.names
            own = {n for n in names if ":" not in n and "RowId" not in n}
            found.setdefault(entity, set()).update(own - {"join", *chunk.timeline_names})
    return found


@RECORDINGS
def test_its_tables_name_everything(samples, section: str, file: str, of_scans: bool) -> None:
    told = documented(section, of_scans)
    assert len(told) > 12
    for entity, components in contents(samples / "topobatch-workspace" / file).items():
        if components or entity.count("/") > 1:
            known = [told[e] for e in told if pattern(e).fullmatch(entity)]
            assert known, f"{entity} is not documented"
            inherited = section == "A merge" and entity.split("/")[1] == "runs"
            assert inherited or components == known[0], entity


@RECORDINGS
def test_its_tables_name_nothing_else(samples, section: str, file: str, of_scans: bool) -> None:
    held = contents(samples / "topobatch-workspace" / file)
    absent = {
        e for e in documented(section, of_scans) if not any(pattern(e).fullmatch(h) for h in held)
    }
    # What these small recordings lack, each for a reason that the tables give.
    assert absent <= {
        "/map/closures/refused",
        "/map/grid",
        *(("/map/detection", "/map/detections") if of_scans else ()),
        "/map/component_N/contradictions",
        "/map/component_N/to record",
    }
