"""Names of sites: where they come from, and that they stay."""

from __future__ import annotations

import itertools

import pytest

from topobatch.merge.sites import (
    Origin,
    SiteHistory,
    site_names,
    sites_from_document,
    sites_to_document,
)
from topobatch.topology.errors import DocumentError


def origins(*runs, folder=("logs",), **folders):
    own = {run: (*folder, folders[run]) if run in folders else folder for run in runs}
    return {run: Origin(own[run], k) for k, run in enumerate(runs)}


def named(components, history=SiteHistory(), known=None, taken=()):  # noqa: B008  frozen
    known = known or origins(*sorted(itertools.chain(*components)))
    return site_names(components, history, known, taken)


def before(**sites):
    return {run: site for site, runs in sites.items() for run in runs}


def test_a_new_site_is_called_after_its_folder() -> None:
    known = origins("a", "b", "c", "d", "e", a="north", b="north", c="south", d="south")
    assert named([["a", "b"], ["c", "d"], ["e"]], known=known)[0] == ["north", "south", "e"]


def test_names_of_runs_that_begin_alike_name_a_site_where_the_folder_tells_nothing() -> None:
    groups = [["north-01", "north-02"], ["south-01", "south-02"], ["x"]]
    assert named(groups)[0] == ["north", "south", "x"]
    # "no" begins others as well, and a folder with a stranger in it still tells more than a number.
    groups = [["north-01", "north-02"], ["north-03"]]
    assert named(groups)[0] == ["logs", "north-03"]


def test_else_it_is_called_after_its_oldest_run() -> None:
    groups = [["b1", "c1"], ["b2", "c2"]]
    known = {run: Origin(("logs",), t) for run, t in zip(("b1", "c1", "b2", "c2"), (5, 3, 1, 2))}  # noqa: B905
    assert named(groups, known=known)[0] == ["site-c1", "site-b2"]
    known["c1"] = Origin(("logs",), None)  # a grid, which nobody drove
    assert named(groups, known=known)[0] == ["site-b1", "site-b2"]


def test_no_two_sites_have_one_name_nor_that_of_something_else() -> None:
    known = origins("a", "b", "c", "d", a="north", b="north", c="south", d="south")
    names, _ = named([["a", "b"], ["c", "d"]], known=known, taken={"north"})
    assert names == ["site-a", "south"]
    history = SiteHistory(before=before(lone=["a", "b"]))
    assert named([["a", "b"], ["lone"]], history)[0] == ["lone", "lone-2"]


def test_names_stay_as_runs_come_and_go() -> None:
    history = SiteHistory(before=before(north=["b", "c"], south=["d", "e"]))
    names, told = named([["a", "b", "c"], ["d", "e", "f"], ["g"]], history)
    assert (names, told) == (["north", "south", "g"], [])
    names, told = named([["d"], ["c"]], history)
    assert (names, told) == (["south", "north"], [])


def test_names_depend_on_no_order() -> None:
    history = SiteHistory({"east": ("f",)}, before(north=["a", "b"], south=["c", "d"]))
    groups = [["a", "c"], ["b", "d"], ["e", "f"], ["g", "h"]]
    known = origins(*"abcdefgh")
    expected = dict(zip(map(tuple, groups), named(groups, history, known)[0], strict=True))
    assert len({*expected.values()}) == 4
    for order in itertools.permutations(groups):
        found = named(list(order), history, known)[0]
        assert dict(zip(map(tuple, order), found, strict=True)) == expected


def test_a_union_keeps_the_name_of_most_runs_and_is_told() -> None:
    history = SiteHistory(before=before(north=["a", "b", "c"], annex=["d", "e"]))
    names, told = named([["a", "b", "c", "d", "e"]], history)
    assert names == ["north"]
    assert told == ["annex, north are one site now: north"]


def test_a_given_name_comes_before_one_that_was_made_up() -> None:
    history = SiteHistory({"annex": ("d",)}, before(north=["a", "b", "c"], annex=["d", "e"]))
    assert named([["a", "b", "c", "d", "e"]], history)[0] == ["annex"]
    history = SiteHistory({"annex": ("d",), "north": ("a",)}, history.before)
    assert named([["a", "b", "c", "d", "e"]], history)[0] == ["north"]


def test_of_a_site_that_comes_apart_the_larger_part_keeps_the_name() -> None:
    history = SiteHistory(before=before(north=["a", "b", "c"]))
    names, told = named([["a"], ["b", "c"]], history)
    assert names == ["a", "north"]
    assert told == ["north came apart: a (a); north (b, c)"]
    names, _ = named([["b"], ["a"]], SiteHistory(before=before(north=["a", "b"])))
    assert names == ["b", "north"]  # the oldest run decides between equals


@pytest.mark.parametrize("run", ["x:y", ".hidden", "a/b", "é" * 150])
def test_every_name_works_as_a_file_name(run) -> None:
    (name,), _ = named([[run]])
    assert name
    assert not set(name) & set("/:\\")
    assert not name.startswith(".")
    assert len(name.encode()) <= 200


def test_the_document_and_back() -> None:
    given = {"south": ("c",), "north": ("a", "b"), "gone": ()}
    assert sites_from_document(sites_to_document(given)) == given
    for bad in ({"site": "../x", "runs": []}, {"site": "x"}, {"site": "x", "runs": [1]}):
        with pytest.raises(DocumentError, match="sites document: sites"):
            sites_from_document({"schema": "topobatch.sites/1", "sites": [bad]})
