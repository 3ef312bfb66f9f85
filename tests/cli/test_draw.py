"""`topobatch draw`, `topobatch report`: what is written, and what is said where nothing can be."""

from __future__ import annotations

RUNS = ("run1", "run2")


def test_a_run_a_merge_and_a_pair_are_drawn(topobatch, merged, tmp_path) -> None:
    a, b = RUNS
    for what, name in ((a, "map.svg"), ("merged", "all.PNG"), (f"{b}:{a}", "pair.svg")):
        done = topobatch("draw", what, tmp_path / "new" / name, "-w", merged)
        assert done.code == 0, done
        assert done.out.strip() == str(tmp_path / "new" / name)
    assert (tmp_path / "new" / "all.PNG").read_bytes().startswith(b"\x89PNG")
    assert f"{a} and {b}:" in (tmp_path / "new" / "pair.svg").read_text()
    light = (tmp_path / "new" / "map.svg").read_bytes()
    topobatch("draw", a, tmp_path / "again.svg", "-w", merged)
    assert (tmp_path / "again.svg").read_bytes() == light
    topobatch("draw", a, tmp_path / "dark.svg", "-w", merged, "--theme", "dark")
    assert (tmp_path / "dark.svg").read_bytes() != light


def test_a_merge_of_another_name_is_drawn(topobatch, merged, tmp_path) -> None:
    a, _ = RUNS
    topobatch("merge", a, "--output", "one", "-w", merged)
    assert topobatch("draw", "one", tmp_path / "one.svg", "-w", merged).code == 0
    assert ": 1 run<" in (tmp_path / "one.svg").read_text()


def test_what_cannot_be_drawn_is_said(topobatch, workspace, tmp_path) -> None:
    a, b = RUNS
    out = tmp_path / "x.svg"
    how = f"topobatch merge --all -w {workspace}"
    assert f"make it with `{how}`" in topobatch("draw", "merged", out, "-w", workspace).error(1)
    # A picture may be shown elsewhere.
    pair = tmp_path / "pair.svg"
    assert topobatch("draw", f"{a}:{b}", pair, "-w", workspace).code == 0
    assert "not merged yet (topobatch merge --all)" in pair.read_text()
    error = topobatch("draw", "nobody", out, "-w", workspace).error(2)
    assert "no run, site, merge or pair A:B" in error
    assert a in error
    assert b in error
    assert "two runs" in topobatch("draw", f"{a}:{a}", out, "-w", workspace).error(2)
    error = topobatch("draw", a, tmp_path / "x.pdf", "-w", workspace).error(2)
    assert "ends in .svg or .png" in error
    assert "topobatch ingest" in topobatch("draw", a, out, "-w", tmp_path / "none").error(1)
    assert not out.exists()


def test_a_report_is_written_where_asked(topobatch, merged, tmp_path, monkeypatch) -> None:
    done = topobatch("report", "-w", merged)
    assert done.code == 0
    page = merged / "report.html"
    assert done.out.strip() == str(page)
    assert done.err == f"reading {len(RUNS)} maps for {page}\n"
    html = page.read_text()
    for run in RUNS:
        assert run in html
    pages = set()
    for _ in range(2):
        monkeypatch.setattr("bokeh.util.serialization._simple_id", 999)  # as in a new process
        topobatch("report", tmp_path / "r.html", "-w", merged)
        pages.add((tmp_path / "r.html").read_bytes())
    assert len(pages) == 1
    assert "ends in .html" in topobatch("report", tmp_path / "r.txt", "-w", merged).error(2)
    assert "--output" in topobatch("report", "--merge", "nix", "-w", merged).error(2)
    assert "topobatch ingest" in topobatch("report", "-w", tmp_path / "none").error(1)


def test_a_report_tells_of_a_broken_map_and_goes_on(topobatch, merged) -> None:
    a, b = RUNS
    (merged / "maps" / f"{a}.json").write_text("{")
    done = topobatch("report", "-w", merged)
    assert done.code == 1
    assert f"{a}.json" in done.err
    html = (merged / "report.html").read_text()
    assert f"The map of {a} cannot be read" in html
    assert b in html
    (merged / "maps" / f"{a}.json").unlink()
    assert topobatch("report", "-w", merged).code == 0
    assert f"no map is there any more of {a}" in (merged / "report.html").read_text()


def test_a_report_of_one_run_lists_the_branches_that_next_lists(topobatch, merged) -> None:
    topobatch("merge", "run1", "--output", "one", "-w", merged)
    *_, line, _ = topobatch("next", "--merge", "one", "-w", merged).out.splitlines()
    assert "junction" in line
    topobatch("report", "--merge", "one", "-w", merged)
    page = (merged / "report.html").read_text()
    assert f"<p>{line.strip()}</p>" in page
    assert page.count(">Runs</a>") == 1


def test_a_report_before_the_first_merge(topobatch, workspace) -> None:
    assert topobatch("report", "-w", workspace).code == 0
    assert "not merged yet" in (workspace / "report.html").read_text()


def test_no_answer_takes_a_write(topobatch, merged, tmp_path, monkeypatch) -> None:
    """As above for whoever runs the tests: nothing can be written into the workspace."""
    import tempfile

    a, b = RUNS
    before = {p: p.stat().st_mtime_ns for p in merged.rglob("*")}
    made = tempfile.mkstemp

    def mkstemp(**how):
        if str(how["dir"]).startswith(str(merged)):
            raise PermissionError(13, "Permission denied", str(how["dir"]))
        return made(**how)

    monkeypatch.setattr(tempfile, "mkstemp", mkstemp)
    done = topobatch("explain", a, b, "-w", merged)
    assert done.code == 0
    assert "bits of evidence" in done.out
    assert topobatch("draw", "merged", tmp_path / "m.svg", "-w", merged).code == 0
    assert topobatch("report", tmp_path / "r.html", "-w", merged).code == 0
    done = topobatch("report", "-w", merged)
    assert done.code == 1
    assert "Permission denied" in done.err
    after = {p: p.stat().st_mtime_ns for p in merged.rglob("*.json")}
    assert after == {p: t for p, t in before.items() if p.suffix == ".json"}
