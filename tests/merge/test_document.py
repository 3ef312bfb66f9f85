"""A merge read back is the merge that was written."""

from __future__ import annotations

import copy
import json

import jsonschema
import numpy as np
import pytest

from topobatch.merge.document import merged_to_document, result_from_document
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.merging import merge_maps
from topobatch.merge.result import Standing


def reread(document):
    return result_from_document(MergedDocument.model_validate(document))


@pytest.fixture(name="document", scope="module")
def _document(mazes):
    rng = np.random.default_rng(5)
    maze = mazes.random_maze(rng, 12, 12)
    order = np.argsort(maze.xy[:, 0] + 0.01 * maze.xy[:, 1])
    error = mazes.Noise(floor_m=0.02, share=0.0)
    maps = [
        mazes.explored_map(maze, sorted(s.tolist()), rng, f"r{k}", noise=error, turn=0.9 * k)
        for k, s in enumerate([order[:55], order[25:95], order[100:]])
    ]
    return merged_to_document(merge_maps(maps))


def test_it_is_written_again_as_it_was(document) -> None:
    assert len(document["graph"]["components"]) < 3
    assert merged_to_document(reread(document)) == document


def test_it_follows_the_published_schema(document) -> None:
    assert document["graph"]["layers"]
    assert any("transform_sigma" in entry for entry in document["merges"])
    read = json.loads(json.dumps(document))
    jsonschema.validate(read, MergedDocument.model_json_schema(by_alias=True))


def test_pairs_that_are_only_counted_stay_counted(document) -> None:
    counted = {"joined": 1, "unrelated": 2, "screened": 3}
    large = {**document, "graph": {**document["graph"], "unlisted": counted}}
    result = reread(large)
    before, after = (reread(doc).standings() for doc in (document, large))
    more = {standing: after[standing] - before[standing] for standing in Standing}
    assert more == dict.fromkeys(Standing, 0) | {Standing.JOINED: 1, Standing.UNRELATED: 5}
    assert merged_to_document(result) == large


@pytest.mark.parametrize(
    ("part", "key", "value", "told"),
    [
        ("nodes", "component", 99, "no component 99"),
        ("nodes", "id", 7, "node ids"),
        ("nodes", "members", {"nobody": [0]}, "'nobody' is a member of what is not its"),
        ("nodes", "y", -1e300, "nodes.0.y"),
        ("merges", "a", "Nobody", "'Nobody' is in no component"),
        ("edges", "target", 10**9, "target is no node"),
        ("edges", "source_branch", 10**9, "source_branch is none"),
    ],
)
def test_what_does_not_fit_together_is_refused(document, part, key, value, told) -> None:
    broken = copy.deepcopy(document)
    broken[part][0][key] = value
    with pytest.raises(ValueError, match=told):
        reread(broken)
