"""`topobatch schema`: every field of the documents says what it is."""

from __future__ import annotations

import json

import pytest


@pytest.mark.parametrize("document", ["map", "merged"])
def test_every_field_is_described(topobatch, document) -> None:
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
