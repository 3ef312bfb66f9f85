"""Maps in other programs' formats, as text: nothing is read or written here.

docs/exports.md says what each format keeps and loses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from ...topology.run import Grid
from ...topology.topomap import TopoMap
from ...topology.turning_vertices import with_turning_points
from ..walls import walls_of
from .free_ways import led_round
from .graphml import graphml
from .lif import lif_json
from .nav2 import nav2_geojson
from .rmf import rmf_yaml
from .route_graph import MAX_ERROR_M
from .tables import corridors_csv, junctions_csv
from .tmap2 import tmap2_yaml

MapFormat = Callable[[TopoMap, float], str]

MAP_FORMATS: Mapping[str, Mapping[str, MapFormat]] = MappingProxyType(
    {
        "nav2": {".geojson": nav2_geojson},
        "lif": {".lif.json": lif_json},
        "rmf": {".rmf.yaml": rmf_yaml},
        "tmap2": {".tmap2.yaml": tmap2_yaml},
        "graphml": {".graphml": lambda topomap, _: graphml(topomap)},
        "csv": {
            ".junctions.csv": lambda topomap, _: junctions_csv(topomap),
            ".corridors.csv": lambda topomap, _: corridors_csv(topomap),
        },
    }
)
"""Formats that need a map only: for each file's suffix the function that returns its text, given
the map and the largest distance [m] of a path from its straight pieces."""


def map_texts(
    topomap: TopoMap, form: str, max_error_m: float = MAX_ERROR_M, walls: Grid | None = None
) -> dict[str, str]:
    """A map, with its turning points, in one of MAP_FORMATS: the text of each file by its suffix.
    Corridors that cross walls are led round them. walls: a grid along the axes of the map's frame;
    by default those of the map's views."""
    whole = with_turning_points(topomap)
    if walls is None:
        walls = walls_of([topomap.views], topomap.frame)
    if walls is not None:
        whole = led_round(whole, walls)
    return {ending: text(whole, max_error_m) for ending, text in MAP_FORMATS[form].items()}


ENDINGS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {form: tuple(texts) for form, texts in MAP_FORMATS.items()}
    | {"g2o": (".g2o",), "tum": (".recorded.tum", ".corrected.tum"), "grid": (".pgm", ".yaml")}
)
"""The suffixes of the files of every format."""
