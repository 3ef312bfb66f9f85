"""`topobatch schema`: the JSON Schema of the documents."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from .output import say_lines


class Document(StrEnum):
    """Documents that topobatch writes."""

    MAP = "map"
    MERGED = "merged"


def schema(
    document: Annotated[Document, typer.Argument(metavar="map|merged", help="Which document.")],
) -> None:
    """Print the JSON Schema of a document.

    map: maps/RUN.json; merged: merged.json.

    \b
      topobatch schema map
    """
    import json

    from ..merge.document import MergedDocument
    from ..topology.map_schema import MapDocument

    model = MapDocument if document is Document.MAP else MergedDocument
    say_lines(json.dumps(model.model_json_schema(by_alias=True), indent=2))
