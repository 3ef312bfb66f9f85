"""A recording as it is on the disk."""

from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader


class Readback:
    """Entities, values and times of an .rrd file."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        (recording,) = reader.recordings()
        self.identity = (recording.application_id, recording.recording_id)
        self.blueprints = len(reader.blueprints())
        self._chunks = [c for c in reader.stream() if not c.entity_path.startswith("/__")]

    @property
    def entities(self) -> set[str]:
        return {c.entity_path for c in self._chunks}

    @property
    def timelines(self) -> set[str]:
        return {name for c in self._chunks for name in c.timeline_names}

    def _columns(self, entity: str, column: str) -> list[Any]:
        batches = [c.to_record_batch() for c in self._chunks if c.entity_path == entity]
        return [b.column(column) for b in batches if column in b.schema.names]

    def rows(self, entity: str, component: str) -> list[Any]:
        """The values of a component, one list for each row."""
        return [row for column in self._columns(entity, component) for row in column.to_pylist()]

    def value(self, entity: str, component: str) -> list[Any]:
        """The values of a component that was logged once."""
        (row,) = self.rows(entity, component)
        return list(row)

    def content(self) -> dict[tuple[str, str], list[Any]]:
        """Everything but the identities of rows and chunks."""
        out: dict[tuple[str, str], list[Any]] = {}
        for chunk in self._chunks:
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if "RowId" not in name:
                    rows = batch.column(name).to_pylist()
                    out.setdefault((chunk.entity_path, name), []).extend(map(repr, rows))
        return out
