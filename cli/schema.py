"""`topobatch schema`: the JSON Schema of the documents."""

from __future__ import annotations

import json
from typing import Annotated, Literal

from ..merge.merged_schema import MergedDocument
from ..topology.map_schema import MapDocument
from .options import verb
from .output import say_lines


@verb
def schema(document: Annotated[Literal["map", "merged"], "map|merged", "Which document."]) -> None:
    """Print the JSON Schema of a document.

    map: maps/RUN.json; merged: merged.json.

    \b
      topobatch schema map
    """
    model = MapDocument if document == "map" else MergedDocument
    say_lines(json.dumps(model.model_json_schema(by_alias=True), indent=2))
