"""Options in groups, as typer takes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer
from typer.testing import CliRunner

from topobatch.cli.options import grouped


@dataclass(frozen=True)
class Group:
    size: Annotated[int, typer.Option(help="How large.")] = 3
    name: str = "x"


def test_the_fields_of_a_group_are_options():
    heard = []

    @grouped
    def command(where: str, group: Group = Group(), fast: bool = False) -> None:
        """What it does."""
        heard.append((where, group, fast))

    app = typer.Typer()
    app.command()(command)
    assert CliRunner().invoke(app, ["there", "--size", "5", "--fast"]).exit_code == 0
    assert CliRunner().invoke(app, ["here", "--name", "y"]).exit_code == 0
    assert heard == [("there", Group(5), True), ("here", Group(3, "y"), False)]
    told = CliRunner().invoke(app, ["--help"]).output
    assert "How large." in told
    assert "What it does." in told
    assert "--group" not in told
