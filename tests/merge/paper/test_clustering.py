"""Clustering: against brute force and examples by hand."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.merge.paper.clustering import ClusterSettings, cluster
from topobatch.merge.paper.hypotheses import Hypotheses
from topobatch.topology.matching.correspondence import Nodes

# --- clusters -------------------------------------------------------------------------------------


def hypotheses(groups, transforms, *, errors=None, rectilinear=False):
    """Hypotheses of the given vertex pairs and transforms."""
    of = np.repeat(np.arange(len(groups)), np.array([len(g) for g in groups], np.int64))
    pairs = np.array([p for g in groups for p in g], np.int64).reshape(-1, 2)
    size = np.bincount(of, minlength=len(groups))
    transforms = np.array(transforms, float)
    return Hypotheses(
        of=of,
        nodes=Nodes(pairs[:, 0], pairs[:, 1], np.zeros(len(pairs), np.int64)),
        size=size,
        corridors=size - 1,
        transform=transforms,
        error=np.zeros(len(groups)) if errors is None else np.array(errors, float),
        bits=np.zeros(len(groups)),
        rectilinear=rectilinear,
    )


XY = np.column_stack([np.arange(12.0) * 3, np.zeros(12)])


def test_linkage_is_complete_no_chain_stretches_a_cluster():
    groups = [[(k, k)] for k in range(5)]
    chain = [[0.4 * k, 0, 0] for k in range(5)]
    settings = ClusterSettings(floor_m=0.5)
    for rectilinear in (False, True):
        h = hypotheses(groups, chain, rectilinear=rectilinear)
        c = cluster(h, (XY, XY), settings)
        assert c.threshold == pytest.approx(0.25)
        spans = [np.ptp(h.transform[c.of == k, 0]) for k in range(len(c))]
        assert max(spans) <= 0.5
        assert len(c) == 3


def test_iterative_clustering_readmits_a_small_hypothesis_by_its_metric_error():
    groups = [[(k, k) for k in range(5)], [(9, 9), (10, 10)]]
    # Two vertices place the second map off: wrong by a turn, near in metric error.
    h = hypotheses(groups, [[0, 0, 0], [0.0, -2.85, 0.1]], errors=[0.01, 0.0])
    assert cluster(h, (XY, XY)).of.tolist() == [0, 1]
    again = cluster(h, (XY, XY), settings=ClusterSettings(iterative=True))
    assert again.of.tolist() == [0, 0]
    assert again.vertices.tolist() == [7]
