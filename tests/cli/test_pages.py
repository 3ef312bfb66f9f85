"""The pages in docs/: what they call and link to is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from topobatch.cli.main import COMMANDS, command_named

ROOT = Path(__file__).parents[2]
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [*sorted(ROOT.glob("*.md")), *DOCS, *sorted(ROOT.glob("[a-z]*/README.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_and_their_options_exist(page) -> None:
    calls = re.findall(r"^    topobatch (.*)$", page.read_text(), re.MULTILINE)
    calls += re.findall(r"`topobatch ([^`]+)`", page.read_text())
    for call in calls:
        words = call.split("#")[0].split("&&")[0].split()
        if not re.fullmatch(r"[a-z]+", words[0]):
            continue  # `topobatch --help`
        assert words[0] in COMMANDS, call
        params = command_named(words[0]).params
        known = {o for p in params for o in (*p.opts, *p.secondary_opts)}
        options = {o for o in re.findall(r"(?<![\w-])--[a-z-]+", " ".join(words)) if o != "--help"}
        assert options <= known, call


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page) -> None:
    for link in re.findall(r"(?<!\])\[[^\]]+\]\((?!https?:)([^)# ]+\.\w+)", page.read_text()):
        assert (page.parent / link).exists(), link
