"""LIF, read by vdma-lif."""

from __future__ import annotations

import numpy as np

from .readers import BOUND_M, distance, read_lif, text_of


def test_lif_gives_curves_as_trajectories(driven, odd_map) -> None:
    for topomap in (driven[1], odd_map):
        (layout,) = read_lif(text_of(topomap, "lif")).layouts
        assert len(layout.nodes) == len(topomap)
        assert len(layout.edges) == 2 * len(topomap.source)
        at = {n.node_id: (n.node_position.x, n.node_position.y) for n in layout.nodes}
        for k, path in enumerate(topomap.paths):
            one, back = layout.edges[2 * k : 2 * k + 2]
            assert (one.start_node_id, one.end_node_id) == (back.end_node_id, back.start_node_id)
            curve = one.vehicle_type_edge_properties[0].trajectory
            line = [at[one.start_node_id], at[one.end_node_id]]
            if curve is not None:
                line = [(p.x, p.y) for p in curve.control_points]
            assert distance(path, np.array(line)).max() < BOUND_M + 1e-3
