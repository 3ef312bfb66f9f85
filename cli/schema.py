"""`topobatch schema`: the JSON Schema of the documents."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from .output import say_lines


def schema(
    document: Annotated[
        Literal["map", "merged"], typer.Argument(metavar="map|merged", help="Which document.")
    ],
) -> None:
    """Print the JSON Schema of a document.

    map: maps/RUN.json; merged: merged.json.

    \b
      topobatch schema map
    """
    import json

    from ..merge.merged_schema import MergedDocument
    from ..topology.map_schema import MapDocument

    model = MapDocument if document == "map" else MergedDocument
    say_lines(json.dumps(model.model_json_schema(by_alias=True), indent=2))
