"""The waypoints of drives to record next, as CSV and as GeoJSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence

from ...merge.drive import Drive, Undriven, drive_to_document
from ...topology.digits import METRES, rounded
from .nav2 import feature


def drives_csv(drives: Sequence[Drive]) -> str:
    """A row for each waypoint: number of the drive and of the stop, the site whose frame x and y
    [m] are in, the site whose junction it is, and the junction's number in the merged document,
    empty at the end of a way into the unknown."""
    rows = [
        (k, i, drive.site, stop.site, "" if stop.junction is None else stop.junction, *stop.xy)
        for k, drive in enumerate(drives, 1)
        for i, stop in enumerate(drive.stops, 1)
    ]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("drive", "stop", "frame", "site", "junction", "x", "y"))
    writer.writerows(rows)
    return out.getvalue()


def drives_geojson(drives: Sequence[Drive], undriven: Sequence[Undriven] = ()) -> str:
    """A line for each drive, a point for each waypoint, and for the junction of each branch that
    nobody drove, in metres of the frame of its site."""
    features = []
    for k, drive in enumerate(drives, 1):
        entry = drive_to_document(drive)
        stops, path = entry.pop("stops"), entry.pop("path")
        about = {"drive": k, "frame": drive.site}
        features.append(feature("LineString", path, about | entry))
        for i, stop in enumerate(stops, 1):
            at = [stop.pop("x"), stop.pop("y")]
            features.append(feature("Point", at, about | {"stop": i} | stop))
    for branch in undriven:
        about = {"frame": branch.site, "kind": "undriven", "junction": branch.junction}
        at = rounded(branch.xy, METRES)
        heading = round(branch.heading_rad, 4)
        features.append(feature("Point", at, about | {"heading": heading}))
    document = {"type": "FeatureCollection", "name": "drives", "features": features}
    return json.dumps(document, ensure_ascii=False, allow_nan=False) + "\n"
