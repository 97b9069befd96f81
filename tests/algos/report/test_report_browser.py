"""The page of a run in a browser: it plays, sorts, saves, fits any width or paper, says nothing."""

import csv
import unicodedata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import listen, serious_findings, unreachable_controls
from report_inputs import group_page, report_page, whatif_page
from slow import slowly

api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

Open = Callable[..., Any]
WIDTHS = (390, *slowly(768), 1440)
ENDINGS = ("contact by", "time-out", "target left", "a pursuer left")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pages")
    pages = {"report": report_page(), "whatif": whatif_page(), "group": group_page()}
    for name, page in pages.items():
        (path / f"{name}.html").write_text(page, encoding="utf-8")
    return path


@pytest.fixture
def open_page(browser: Any, folder: Path) -> Iterator[Open]:
    """Opens the page in a window; afterwards nothing may have been said or asked for."""
    said: list[str] = []
    contexts = []

    def opened(width: int = 1440, height: int = 900, name: str = "report", **options: Any) -> Any:
        context = browser.new_context(
            viewport={"width": width, "height": height}, reduced_motion="reduce", **options
        )
        contexts.append(context)
        page = listen(context.new_page(), said)
        page.goto((folder / f"{name}.html").as_uri())
        page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []


SLOW = 60_000  # of a machine that does other work as well [ms]


def frame(page: Any) -> int:
    return int(page.input_value("#time"))


def drawn(page: Any) -> list[str]:
    """What the panels show, as pixels."""
    return list(
        page.eval_on_selector_all("#panels canvas", "all => all.map(one => one.toDataURL())")
    )


def test_the_player_plays_to_the_end_and_begins_again(open_page: Open) -> None:
    page = open_page()
    before = drawn(page)
    assert len(before) == 2 and frame(page) == 0
    page.select_option("#speed", "0.25")
    page.click("#play")
    assert page.inner_text("#play") == "Pause"
    page.select_option("#speed", "8")
    api.expect(page.locator("#play")).to_have_text("Play", timeout=SLOW)
    last = int(page.get_attribute("#time", "max"))
    assert frame(page) == last > 5
    after = drawn(page)
    assert all(one != other for one, other in zip(before, after, strict=True))
    states = page.locator("#panels output").all_inner_texts()
    assert all(state.startswith(ENDINGS) and state.endswith(" s") for state in states), states
    page.click("#play")
    api.expect(page.locator("#time")).not_to_have_value("0")
    assert page.inner_text("#clock").endswith(" s")


def test_it_starts_by_itself_unless_motion_is_to_be_reduced(open_page: Open) -> None:
    page = open_page()
    assert page.inner_text("#play") == "Play"
    page.emulate_media(reduced_motion="no-preference")
    page.reload()
    api.expect(page.locator("#time")).not_to_have_value("0")


def test_it_is_scrubbed_and_moved_by_keys(open_page: Open) -> None:
    page = open_page()
    page.locator("#time").fill("3")
    assert frame(page) == 3
    page.focus("#panels")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert frame(page) == 4 and page.inner_text("#clock").startswith("0.4 of ")
    page.keyboard.press("End")
    assert frame(page) == int(page.get_attribute("#time", "max"))
    page.keyboard.press("Home")
    assert frame(page) == 0
    page.keyboard.press("+")
    assert page.input_value("#speed") == "2"
    page.keyboard.press("ArrowDown")
    assert page.input_value("#start") == "1"
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowUp")
    count = page.locator("#start option").count()
    assert page.input_value("#start") == str(count - 1)
    page.keyboard.press(" ")
    assert page.inner_text("#play") == "Pause"
    page.focus("#start")
    page.keyboard.press(" ")  # a list keeps its own keys
    assert page.inner_text("#play") == "Pause"


@pytest.mark.parametrize("name", ["report", "whatif"])
def test_every_control_is_reached_by_keys_and_shows_it(open_page: Open, name: str) -> None:
    assert unreachable_controls(open_page(name=name)) == []


def test_zoomed_in_the_animals_stay_in_the_middle(open_page: Open) -> None:
    page = open_page()
    page.locator("#time").fill("3")
    whole = drawn(page)
    page.select_option("#zoom", "16")
    near = drawn(page)
    assert all(one != other for one, other in zip(whole, near, strict=True))
    page.locator("#time").fill("6")
    assert drawn(page) != near
    page.select_option("#zoom", "1")
    page.locator("#time").fill("3")
    assert drawn(page) == whole


def test_an_answer_opens_with_both_worlds_and_the_team(open_page: Open) -> None:
    page = open_page(name="whatif")
    titles = page.locator("#view option").all_inner_texts()
    assert titles == [
        "condition=shared beside unchanged",
        "condition=shared beside condition=shared: the team that made the recordings",
        "unchanged beside demonstrated",
    ]
    assert page.locator("#panels").bounding_box()["y"] < 900
    shown = []
    for view in range(3):
        page.select_option("#view", str(view))
        page.locator("#time").fill("6")
        shown.append(drawn(page))
    (unchanged, changed), (team, again), (recorded, same) = shown
    assert (again, same) == (changed, unchanged)
    assert len({unchanged, changed, team, recorded}) == 4


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
def test_verdict_and_player_are_on_the_first_screen(
    open_page: Open, width: int, height: int
) -> None:
    page = open_page(width, height)
    for selector in (".headline", "#panels"):
        box = page.locator(selector).bounding_box()
        assert box["y"] >= 0 and box["y"] + min(box["height"], 100) < height


def numbers(page: Any, table: str, column: int, body: int = 0) -> list[str]:
    rows = page.locator(f"{table} >> tbody >> nth={body} >> tr:not(.group)")
    return [rows.nth(i).locator("th, td").nth(column).inner_text() for i in range(rows.count())]


def test_tables_sort_within_their_groups(open_page: Open) -> None:
    page = open_page()
    table = "table[data-name^=metrics]"  # all episodes, captures only
    heading = page.locator(f"{table} >> thead >> th >> nth=3")
    given = [numbers(page, table, 0, body) for body in (0, 1)]
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "ascending"
    for body in (0, 1):
        means = [float(text.split(" [")[0]) for text in numbers(page, table, 3, body)]
        assert means == sorted(means) and len(set(means)) > 1
        assert sorted(numbers(page, table, 0, body)) == sorted(given[body])
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "descending"
    means = [float(text.split(" [")[0]) for text in numbers(page, table, 3)]
    assert means == sorted(means, reverse=True)
    titles = page.locator(f"{table} >> thead >> th").all_inner_texts()
    column = next(i for i, title in enumerate(titles) if title.lower().startswith("energy"))
    gaps = page.locator(f"{table} >> thead >> th >> nth={column}")
    for _ in range(2):  # what is not defined stands last either way
        gaps.locator("button").click()
        assert numbers(page, table, column)[-1] == ""
    assert heading.get_attribute("aria-sort") is None


def test_figures_and_tables_are_saved(open_page: Open, tmp_path: Path) -> None:
    page = open_page()
    saved = {}
    for kind, place in (("SVG", ".picture"), ("PNG", ".picture"), ("CSV", "figure.table")):
        with page.expect_download() as download:
            page.locator(f"{place} >> button:text-is('{kind}')").nth(1).click()
        saved[kind] = tmp_path / download.value.suggested_filename
        download.value.save_as(saved[kind])
        assert saved[kind].suffix == f".{kind.lower()}"
    drawing = saved["SVG"].read_text(encoding="utf-8")
    assert drawing.startswith("<svg") and "var(" not in drawing and "#2b2b2f" in drawing
    assert saved["PNG"].read_bytes().startswith(b"\x89PNG")
    assert saved["PNG"].stat().st_size > 5_000
    rows = list(csv.reader(saved["CSV"].read_text(encoding="utf-8").splitlines()))
    assert len({len(row) for row in rows}) == 1 and len(rows) > 2
    with page.expect_download() as download:
        page.locator("#metrics figure.table >> button:text-is('CSV')").click()
    download.value.save_as(tmp_path / "lengths.csv")
    table = list(csv.DictReader((tmp_path / "lengths.csv").open(encoding="utf-8")))
    assert {row["Group"] for row in table} == {"All episodes", "Captures only"}
    mean = "path length (arena units)"
    for row in table:
        assert float(row[f"{mean} low"]) <= float(row[mean]) <= float(row[f"{mean} high"])


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize(("name", "least"), [("report", 16), ("whatif", 4)])
def test_nothing_overflows_and_pictures_are_there(
    open_page: Open, width: int, name: str, least: int
) -> None:
    page = open_page(width, name=name)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    boxes = page.eval_on_selector_all(
        ".picture svg, #panels canvas",
        "all => all.map(one => one.getBoundingClientRect()).map(b => [b.width, b.height, b.right])",
    )
    assert len(boxes) >= least
    assert all(w > 40 and h > 40 and right <= width for w, h, right in boxes)


@pytest.mark.parametrize("name", ["report", "group"])
def test_a_page_has_at_most_eight_screens(open_page: Open, name: str) -> None:
    page = open_page(1280, 800, name=name)
    page.reload()
    assert page.evaluate("document.documentElement.scrollHeight") <= 8 * 800


def test_details_are_folded_until_they_are_asked_for(open_page: Open) -> None:
    page = open_page(1280, 800)
    page.reload()
    assert not page.is_visible("#provenance p >> nth=0")
    page.click("#provenance summary")
    assert page.is_visible("#provenance p >> nth=0")


def test_the_first_column_stays_in_sight(open_page: Open) -> None:
    page = open_page(390)
    region = page.locator("#metrics .scroll")
    cell = region.locator("tbody tr:not(.group) th").first
    left = cell.bounding_box()["x"]
    moved = region.evaluate("region => { region.scrollLeft = 9999; return region.scrollLeft; }")
    assert moved > 50
    assert cell.bounding_box()["x"] == pytest.approx(left, abs=1)


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("name", ["report", "group"])
def test_the_table_of_the_verdict_fits(open_page: Open, name: str, width: int) -> None:
    table = open_page(width, name=name).locator("#verdict .scroll").first
    assert table.evaluate("one => one.scrollWidth - one.clientWidth") <= 0
    shown = [one.inner_text() for one in table.locator("thead th").all() if one.is_visible()]
    assert shown[1].startswith("Verdict") and (len(shown) >= 9) == (width > 390)


CONTRASTS = """() => {
  const shade = (text) => text.match(/[\\d.]+/g).map(Number);
  const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  const luminance = ([r, g, b]) => 0.2126 * linear(r / 255) + 0.7152 * linear(g / 255)
    + 0.0722 * linear(b / 255);
  const ground = (element) => {
    for (let one = element; one; one = one.parentElement) {
      const parts = shade(getComputedStyle(one).backgroundColor);
      if (parts.length === 3 || parts[3] > 0) return parts;
    }
    return [255, 255, 255];
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [];
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    const box = element.getBoundingClientRect();
    const text = walker.currentNode.textContent.trim();
    if (!text || !box.width || element.closest("script, style, option")) continue;
    const style = getComputedStyle(element);
    const ink = shade(element.closest("svg") ? style.fill : style.color);
    const pair = [luminance(ink), luminance(ground(element))].sort((a, b) => a - b);
    found.push([(pair[1] + 0.05) / (pair[0] + 0.05), text]);
  }
  return found;
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_text_can_be_read_in_both_themes(open_page: Open, scheme: str) -> None:
    page = open_page(color_scheme=scheme)
    found = page.evaluate(CONTRASTS)
    assert len(found) > 500
    assert [text for ratio, text in found if ratio < 4.5] == []


def test_the_button_changes_the_theme_of_page_and_figures(open_page: Open) -> None:
    page = open_page(color_scheme="light")

    def colours() -> tuple[str, str]:
        ink = ".picture svg text"
        return (
            page.evaluate("getComputedStyle(document.body).backgroundColor"),
            page.eval_on_selector(ink, "one => getComputedStyle(one).fill"),
        )

    light, canvas = colours(), drawn(page)
    assert light == ("rgb(255, 255, 255)", "rgb(43, 43, 47)")
    assert page.inner_text("#theme") == "Dark"
    page.click("#theme")
    assert all(one != other for one, other in zip(light, colours(), strict=True))
    assert drawn(page) != canvas
    page.click("#theme")
    assert colours() == light and drawn(page) == canvas
    page.emulate_media(media="print", color_scheme="dark")  # paper is white
    assert colours()[1] == light[1]
    assert not page.is_visible("#player") and page.is_visible(".lead")


PAGES = {"report": report_page, "whatif": whatif_page}
SAME_LINE = 2.0  # [pt]
# What goes with the thing below it, and the captions that go with the picture above.
BEFORE = "h2, h3, section > p:not(:last-child), figure.table > figcaption, summary, tr.group"
AFTER = ".pictures > figcaption"


def plain(text: str) -> str:
    """Without ligatures and spaces."""
    return "".join(unicodedata.normalize("NFKC", text).split()).casefold()


def lines(page: Any) -> list[tuple[float, str]]:
    """Height above the lower edge [pt] and words of every line, from top to bottom."""
    found: list[tuple[float, float, str]] = []

    def seen(text: str, matrix: list[float], place: list[float], *_: Any) -> None:
        if text.strip():
            x = matrix[4] + place[4] * matrix[0] + place[5] * matrix[2]
            y = matrix[5] + place[4] * matrix[1] + place[5] * matrix[3]
            found.append((y, x, text))

    page.extract_text(visitor_text=seen)
    rows: list[list[tuple[float, float, str]]] = []
    for one in sorted(found, reverse=True):
        if rows and rows[-1][0][0] - one[0] < SAME_LINE:
            rows[-1].append(one)
        else:
            rows.append([one])
    return [
        (row[0][0], plain("".join(text for _, _, text in sorted(row, key=lambda one: one[1]))))
        for row in rows
    ]


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("paper", ["A4", *slowly("Letter")])
def test_pages_break_where_nothing_is_parted(
    browser: Any, tmp_path: Path, name: str, paper: str
) -> None:
    """No heading is parted from what it heads, no caption from its figure; no page is half empty.

    Printed by the browser, and read back with the place of every line.
    """
    pypdf = pytest.importorskip("pypdf", reason="pypdf is not installed")
    file = tmp_path / "page.html"
    file.write_text(PAGES[name](), encoding="utf-8")
    page = browser.new_page()
    page.goto(file.as_uri())
    page.pdf(path=tmp_path / "page.pdf", format=paper)
    page.emulate_media(media="print")
    texts = {
        kind: [plain(text) for text in page.locator(kind).all_inner_texts() if text.strip()]
        for kind in (BEFORE, AFTER)
    }
    page.close()
    printed = pypdf.PdfReader(tmp_path / "page.pdf").pages
    assert len(printed) > 1 and all(texts.values())
    whole = [lines(one) for one in printed]
    everything = "".join(line for one in whole for _, line in one)
    assert all(heading in everything for heading in texts[BEFORE] if len(heading) < 30)
    for number, one in enumerate(whole[:-1], start=1):
        bottom, last = one[-1]
        half = float(printed[number - 1].mediabox.height) / 2
        assert bottom < half, f"page {number} is half empty, below {last!r}"
        parted = [text for text in texts[BEFORE] if ends(text, last)]
        assert not parted, f"page {number} ends with {parted[0]!r}"
        _, first = whole[number][0]
        parted = [text for text in texts[AFTER] if begins(text, first)]
        assert not parted, f"page {number + 1} begins with {parted[0]!r}"


def begins(text: str, line: str) -> bool:
    """Whether a line is all of a text, or its first; a heading may begin with the same words."""
    return text == line or (len(line) > 40 and text.startswith(line))


def ends(text: str, line: str) -> bool:
    """Whether a line is all of a text, or the last of its lines."""
    return text == line or (len(line) > 12 and text.endswith(line))


@pytest.mark.parametrize(("name", "scheme"), [("report", "light"), ("group", "dark")])
def test_axe_finds_nothing_serious_on_the_page_of_a_run(
    open_page: Open, name: str, scheme: str
) -> None:
    assert serious_findings(open_page(390, name=name, color_scheme=scheme)) == []
