"""Pages on paper: no heading parted from what it heads, no caption from its figure.

None is half empty. Printed by the browser, and read back with the place of every line.
"""

import unicodedata
from pathlib import Path
from typing import Any

import pytest
from report_inputs import asked_page, inspected_page, report_page

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pypdf = pytest.importorskip("pypdf", reason="pypdf is not installed")

PAGES = {"report": report_page, "counterfactual": asked_page, "inspection": inspected_page}
SAME_LINE = 2.0  # [pt]
# What goes with the thing below it, and the captions that go with the picture above.
BEFORE = "h2, h3, section > p, figure.table > figcaption, summary, tr.group"
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
@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_pages_break_where_nothing_is_parted(
    browser: Any, tmp_path: Path, name: str, paper: str
) -> None:
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
