"""The report in a real Chromium, driven by Playwright. Debian has it as chromium-headless-shell."""

import shutil
from dataclasses import replace

import pytest
from PIL import Image

from topobatch.merge.result import Standing
from topobatch.viz.report import Report, report_page

from .test_report import HOSTILE, change, decision, drive, named

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="there is no Chromium here")
DESK = {"viewport": {"width": 1280, "height": 900}}
DRAWN = "html[data-drawn=all]"
MAP = ".site .map"
WIDTH = """place => { const plot = plots.get(place);
    return plot.then(p => p.x_range.end - p.x_range.start) }"""


@pytest.fixture(scope="module")
def chromium():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def opened(chromium, tmp_path):
    """opened(html, **how): the page, drawn; what went wrong on it, and what it asked for, is empty
    when the test ends."""
    faults: list[str] = []
    contexts = []

    def open_(html: str, **how):
        file = tmp_path / "report.html"
        file.write_text(html, encoding="utf-8")
        context = chromium.new_context(**DESK | how)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: faults.append(f"{error}"))
        page.on("dialog", lambda dialog: faults.append(dialog.message))
        page.on("console", lambda m: faults.append(m.text) if m.type in ("error", "warning") else 0)
        page.on(
            "request",
            lambda r: 0 if r.url.startswith(("data:", file.as_uri())) else faults.append(r.url),
        )
        page.goto(file.as_uri())
        page.wait_for_selector(DRAWN, state="attached")
        return page

    yield open_
    for context in contexts:
        context.close()
    assert faults == []


@pytest.fixture
def html(merge_of):
    """A page with something of everything."""
    result, maps = merge_of([["a", "b"], ["c"]], [("b", "c")])
    pair = next(v for v in result.verdicts if v.standing is Standing.AMBIGUOUS)
    return report_page(
        Report(
            {m.run: m for m in maps},
            named(result),
            drives=[drive()],
            changes=[change()],
            decisions={("b", "c"): decision(pair)},
        )
    )


def picture(page, selector: str, tmp_path):
    """The number of colours in a picture of a part of the page, and its commonest colour."""
    path = tmp_path / "shot.png"
    page.locator(selector).first.screenshot(path=path)
    with Image.open(path) as image:
        found = image.convert("RGB").getcolors(1 << 24)
    return len(found), max(found)[1]


def shows(page, selector: str, words: str) -> None:
    """Wait until a part of the page shows these words."""
    from playwright.sync_api import expect

    expect(page.locator(selector).first).to_contain_text(words)


def at(page, selector: str, x: float, y: float) -> tuple[float, float]:
    """The place on the screen of a point of a figure, by its data."""
    place = page.locator(selector).first
    place.scroll_into_view_if_needed()
    box = place.bounding_box()
    share = place.evaluate(
        """async (place, [x, y]) => {
        const p = await plots.get(place), view = Bokeh.index.get_by_id(p.id);
        return [view.frame.x_scale.compute(x), view.frame.y_scale.compute(y)] }""",
        [x, y],
    )
    return box["x"] + share[0], box["y"] + share[1]


def test_a_map_is_clicked_moved_zoomed_and_its_layers_switched(opened, html, tmp_path) -> None:
    page = opened(html)
    colours, _ = picture(page, MAP, tmp_path)
    assert colours > 20
    told = page.locator(".site .about").first
    # Junction 2 of the square.
    place = page.evaluate(
        """async () => { const p = await plots.get(document.querySelector('.site .map'));
        const at = p.renderers.filter(r => r.glyph.text).map(r => r.data_source)
          .flatMap(s => s.every.map((n, k) => [n, s.data.x[k], s.data.y[k]]));
        return at.find(row => row[0] === "2").slice(1) }"""
    )
    page.mouse.click(*at(page, MAP, *place))
    shows(page, ".site .about", "Junction 2:")
    shown = page.evaluate(
        """async () => (await plots.get(document.querySelector('.site .map'))).renderers
        .filter(r => r.glyph.text).flatMap(r => r.data_source.data.text)"""
    )
    assert {"drive 1", "0"} <= set(shown)  # it begins at junction 0
    page.locator(".site .find").first.fill("4")
    page.keyboard.press("Enter")
    shows(page, ".site .about", "Junction 4 (dead end):")
    page.locator(".site [data-zoom='0']").first.click()
    wide = page.locator(MAP).first.evaluate(WIDTH)
    page.locator(".site [data-zoom='0.67']").first.click()
    assert page.locator(MAP).first.evaluate(WIDTH) < 0.7 * wide
    page.locator(".site [data-zoom='0']").first.click()
    box = page.locator(MAP).first.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.wheel(0, -240)  # the page scrolls, the map stays
    assert page.locator(MAP).first.evaluate(WIDTH) == pytest.approx(wide)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -240)
    page.keyboard.up("Control")
    assert page.locator(MAP).first.evaluate(WIDTH) < wide
    before, _ = picture(page, MAP, tmp_path)
    layers = page.locator(".site").first.locator(".layers input").all()
    marks = page.locator(".site").first.locator(".layers i").all()
    assert {mark.get_attribute("data-mark") for mark in marks} == {"line", "circle"}
    layers[0].uncheck()
    page.emulate_media(media="print")  # the key is printed, of what is shown
    assert page.locator(".site .layers label:visible").count() == len(layers) - 1
    assert page.locator(":is(.zoom, .find, .hint):visible").count() == 0
    page.emulate_media(media="screen")
    for layer in layers:
        layer.uncheck()
    assert told.text_content()
    assert picture(page, MAP, tmp_path)[0] < before


def test_a_square_of_the_matrix_opens_its_pair(opened, html, tmp_path) -> None:
    page = opened(html)
    page.mouse.click(*at(page, "#matrix", 1.5, 0.5))
    shows(page, "#pair-title", "a + b")
    shows(page, "#pair-title", "a + b: merged, 40.0 bits")
    shows(page, "#pair-verdict", "topobatch explain a b")
    page.locator("#run-a").select_option("1")
    page.locator("#run-b").select_option("2")
    shows(page, "#pair-title", "b + c")
    assert page.locator("#pair figure:visible").count() == 2
    shows(page, "#evidence", "corridor: 10.00 m, 10.10 m")
    commands = page.locator("#pair .copy code").all_inner_texts()
    assert commands[0].startswith("topobatch lock b c --same --at ")
    assert commands[1] == "topobatch lock b c --same"  # all its pairs are those of the best, too
    assert commands[2] == "topobatch lock b c --never"
    page.locator("#pair .copy button").first.click()
    shows(page, "#pair .copy button", "copied")
    colours, _ = picture(page, "#pair .map", tmp_path)
    assert colours > 20
    page.locator("#run-b").select_option("0")  # each box keeps what was chosen in it
    shows(page, "#pair-title", "a + b")
    assert [page.locator(f"#run-{box}").input_value() for box in "ab"] == ["1", "0"]
    page.locator("#run-b").select_option("")
    shows(page, "#pair-title", "b")
    assert page.locator("#pair figure:visible").count() == 1
    page.locator("#undecided").click()
    shows(page, "#pair-title", "b + c")


def test_a_pair_is_opened_in_the_order_of_its_verdict(opened, merge_of) -> None:
    result, maps = merge_of([["a"], ["b", "c"]], [("a", "c")])
    page = opened(report_page(Report({m.run: m for m in maps}, named(result))))
    page.locator("#run-a").select_option(label="c")
    page.locator("#run-b").select_option(label="a")
    shows(page, "#pair-title", "a + c")
    shows(page, "#pair figcaption", "a  c")
    shows(page, "#pair-verdict", "topobatch explain a c")
    assert "lock a c" in page.locator("#never code").inner_text()


def test_the_evidence_of_a_pair_fits_a_phone(opened, html) -> None:
    """Also with a column for the next best placement."""
    page = opened(html, viewport={"width": 390, "height": 800})
    page.evaluate("chosen(1, 2)")
    shows(page, "#evidence", "corridor: 10.00 m, 10.10 m")
    wide = page.evaluate("find('.wide').scrollWidth - find('.wide').clientWidth")
    assert wide == 0
    shows(page, "#pair", "Wide green lines are links that speak for a placement")


def test_no_name_becomes_code(opened, merge_of) -> None:
    result, maps = merge_of([[f"a{HOSTILE}", "b"], ["c"]], [("b", "c")])
    info = {"warnings": [HOSTILE], "settings": {HOSTILE: HOSTILE}}
    maps[0] = replace(maps[0], info=info)
    sites = tuple(replace(c, site=f"{HOSTILE} {c.id}") for c in result.components)
    pairs = [replace(v, reason=HOSTILE, advice=HOSTILE) for v in result.verdicts]
    result = replace(result, components=sites, verdicts=tuple(pairs))
    html = report_page(
        Report(
            {m.run: m for m in maps},
            result,
            drives=[replace(drive(), site=HOSTILE)],
            locks=[HOSTILE],
            where=("-w", HOSTILE),
        )
    )
    page = opened(html)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        page.locator("#run-a").select_option(str(i))
        page.locator("#run-b").select_option(str(j))
    page.locator(".site .find").first.fill("0")
    page.keyboard.press("Enter")
    shows(page, ".site .about", "Junction 0")
    shows(page, ".site .about", HOSTILE)
    assert page.locator("img").count() == 0
