"""Names of sites: where they come from, and that they stay."""

from __future__ import annotations

import itertools

from topobatch.merge.sites import Origin, SiteHistory, moved_sites, site_names


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
    assert named([["a", "b"], ["c", "d"], ["e"]], known=known) == ["north", "south", "e"]
    known = origins("hall-1", "hall-2", folder=("north", "Logs"))
    assert named([["hall-1", "hall-2"]], known=known) == ["hall"]
    for runs, site in (
        (["E5_01", "E5_02"], "E5"),
        (["lab_2024-05-01", "lab_2024-05-17"], "lab"),
        (["floor1", "floor12"], "floor"),
        (["2015-04", "2015-09"], "site-2015-04"),
    ):
        assert named([runs], known=origins(*runs)) == [site]


def test_no_two_sites_have_one_name_nor_that_of_something_else() -> None:
    known = origins("a", "b", "c", "d", a="north", b="north", c="south", d="south")
    names = named([["a", "b"], ["c", "d"]], known=known, taken={"north"})
    assert names == ["site-a", "south"]
    history = SiteHistory(before=before(lone=["a", "b"]))
    assert named([["a", "b"], ["lone"]], history) == ["lone", "lone-2"]


def test_names_stay_as_runs_come_and_go() -> None:
    history = SiteHistory(before=before(north=["b", "c"], south=["d", "e"]))
    names = named([["a", "b", "c"], ["d", "e", "f"], ["g"]], history)
    assert names == ["north", "south", "g"]
    names = named([["d"], ["c"]], history)
    assert names == ["south", "north"]


def test_a_union_keeps_the_name_of_most_runs() -> None:
    history = SiteHistory(before=before(north=["a", "b", "c"], annex=["d", "e"]))
    names = named([["a", "b", "c", "d", "e"]], history)
    assert names == ["north"]


def test_sites_that_became_one_or_came_apart_are_told() -> None:
    was = before(north=["a", "b", "c"], annex=["d", "e"], f=["f"])
    union = before(north=["a", "b", "c", "d", "e", "f"])
    assert moved_sites(was, union) == ["annex, north are one site now: north"]
    assert moved_sites(was, {**was, "f": "north"}) == []
    apart = {**was, "c": "annex", "e": "e"}
    assert moved_sites(was, apart) == [
        "annex came apart: annex, e",
        "north came apart: annex, north",
    ]
    assert moved_sites(was, {"a": "north", "g": "g"}) == []


def test_a_given_name_comes_before_one_that_was_made_up() -> None:
    history = SiteHistory({"annex": ("d",)}, before(north=["a", "b", "c"], annex=["d", "e"]))
    assert named([["a", "b", "c", "d", "e"]], history) == ["annex"]
    history = SiteHistory({"annex": ("d",), "north": ("a",)}, history.before)
    assert named([["a", "b", "c", "d", "e"]], history) == ["north"]
