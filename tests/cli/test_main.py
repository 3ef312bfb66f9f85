"""The command as a program: exit codes, messages, what goes to which stream."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from topobatch.merge.merged_schema import MergedDocument
from topobatch.topology.map_schema import MapDocument

from .conftest import Shown


def test_help_and_version(topobatch):
    assert topobatch("--version").out.startswith("topobatch 0.")
    shown = topobatch("--help")
    assert shown.code == 0
    commands = (
        "ingest merge view draw report list info explain export transfer changes lock discard "
        "rename history simulate schema"
    )
    for command in commands.split():
        assert f"  {command} " in shown.out
        help_text = topobatch(command, "--help")
        assert help_text.code == 0
        assert "Usage: topobatch" in help_text.out


@pytest.mark.parametrize(("name", "model"), [("map", MapDocument), ("merged", MergedDocument)])
def test_schema_is_published(topobatch, name, model):
    assert json.loads(topobatch("schema", name).out) == model.model_json_schema(by_alias=True)


@pytest.mark.parametrize("document", ["map", "merged"])
def test_every_field_of_the_documents_is_described(topobatch, document) -> None:
    schema = json.loads(topobatch("schema", document).out)
    parts = {document: schema, **schema["$defs"]}
    fields = {
        f"{part}.{name}": field
        for part, of in parts.items()
        for name, field in of.get("properties", {}).items()
    }
    assert len(fields) > 30
    assert [name for name, field in fields.items() if not field.get("description")] == []
    assert all(of.get("description") for of in parts.values())


def test_view_without_a_display_says_how(topobatch, tmp_path):
    (tmp_path / "merged.rrd").write_bytes(b"")
    done = topobatch("view", "-w", tmp_path)
    assert done.code == 0
    assert "no display" in done.out
    assert "rerun" in done.out


@pytest.mark.skipif(sys.platform == "win32", reason="limits of processes")
def test_a_full_disk_is_said_and_waited_for_by_nobody(logs, tmp_path):
    code = (
        "import resource, sys; from topobatch.cli.main import main; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)); main()"
    )
    command = [sys.executable, "-c", code, "ingest", logs["mcap"], "-w", tmp_path / "ws"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    error = Shown(done.returncode, done.stdout, done.stderr).error(1)
    assert str(tmp_path / "ws" / "maps") in error
    assert ".rrd: File too large" in error
    assert not list((tmp_path / "ws" / "maps").iterdir())  # half a run is none


def test_the_options_of_the_papers_method_come_last(topobatch) -> None:
    for command in ("merge", "explain"):
        before, title, after = topobatch(command, "--help").out.partition(
            "\nOptions of --method paper:\n"
        )
        assert title
        assert "--degree" in after
        assert "--degree" not in before
        assert "--workspace" in before
