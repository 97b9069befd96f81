"""What holds of the page without a browser: it loads nothing, can be read, and tells its names."""

import base64
import hashlib
import itertools
import re

import numpy as np
import pytest
from html_page import Page
from report_inputs import report_page

from animarl_algos.report.page import SCRIPTS, TEMPLATES
from animarl_algos.report.style import COLOURS, FLOOR, PAGE, PURSUERS, RAISED, TARGET, TEXTS, themed
from animarl_envs.drawing.palette import RGB

MOST = 6_000_000  # bytes of a page
GROUNDS = (PAGE, RAISED, FLOOR)


@pytest.fixture(scope="module")
def page() -> Page:
    return Page(report_page())


def sheet() -> str:
    found = re.search(r"<style>(.*?)</style>", report_page(), re.DOTALL)
    assert found is not None
    return found[1]


def variables(selector: str) -> dict[str, RGB]:
    """Colours that the style sheet gives to a selector, by name."""
    block = re.search(re.escape(selector) + r"\s*\{(.*?)\}", sheet(), re.DOTALL)
    assert block is not None
    return {
        name: (int(code[:2], 16), int(code[2:4], 16), int(code[4:], 16))
        for name, code in re.findall(r"--([\w-]+): #([0-9a-f]{6});", block[1])
    }


# -- alone, and whole -----------------------------------------------------------------------------


def test_the_page_loads_nothing(page: Page) -> None:
    assert page.loads == []
    tags = {tag for tag, _ in page.elements}
    assert not tags & {"link", "iframe", "object", "embed", "img", "base", "form"}
    assert "url(" not in sheet() and "@import" not in sheet()
    references = [
        str(given[key])
        for _, given in page.elements
        for key in ("href", "xlink:href")
        if key in given
    ]
    assert references
    assert all(one.startswith(("#", "data:image/png;base64,")) for one in references)
    assert len(report_page().encode()) < MOST


def test_the_browser_is_told_to_run_this_script_alone(page: Page) -> None:
    (script,) = page.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policies = [
        str(given["content"])
        for tag, given in page.elements
        if tag == "meta" and given.get("http-equiv") == "Content-Security-Policy"
    ]
    assert len(policies) == 1
    assert policies[0].startswith("default-src 'none'")
    assert f"script-src 'sha256-{digest}'" in policies[0]
    assert "http" not in policies[0]
    assert "innerHTML" not in script and "eval(" not in script  # names stay text
    assert not any(key.startswith("on") for _, given in page.elements for key in given)


def test_every_script_and_sheet_is_short_and_used() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in TEMPLATES.iterdir()}
    assert {name for name in texts if name.endswith(".js")} == set(SCRIPTS)
    templates = "\n".join(text for name, text in texts.items() if name.endswith(".j2"))
    for name, text in texts.items():
        assert len(text.splitlines()) <= 300
        if name.endswith(".css"):
            assert f'"{name}"' in templates


# -- told to those who do not see it --------------------------------------------------------------


def test_ids_are_unique_and_references_find_them(page: Page) -> None:
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    for tag, given in page.elements:
        if "for" in given:
            assert given["for"] in page.ids, tag
    used = re.findall(r"getElementById\(\"(\w+)\"\)|this\.find\(\"(\w+)\"\)", page.scripts[0])
    assert used and all((first or second) in page.ids for first, second in used)


def test_controls_figures_and_regions_have_names(page: Page) -> None:
    for tag, given in page.elements:
        if tag in ("input", "section") and "id" not in given:
            assert given.get("aria-label"), tag
        if tag == "svg" or given.get("role") in ("region", "group", "img"):
            assert given.get("aria-label"), tag
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


# -- colours --------------------------------------------------------------------------------------


def contrast(first: RGB, second: RGB) -> float:
    """Contrast ratio, 1 to 21 (WCAG 2.2)."""

    def luminance(colour: RGB) -> float:
        part = np.array(colour) / 255
        linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    dark, light = sorted((luminance(first), luminance(second)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize(
    "selector",
    [':root, :root[data-theme="light"]', ':root[data-theme="dark"]', ":root:not([data-theme])"],
)
def test_texts_and_marks_stand_out_from_every_ground(selector: str) -> None:
    told = variables(selector)
    assert set(told) == {colour.name for colour in COLOURS}
    for ground in GROUNDS:
        for text in TEXTS:
            assert contrast(told[text.name], told[ground.name]) >= 4.5, (text, ground)
        for mark in (*PURSUERS, TARGET):
            assert contrast(told[mark.name], told[ground.name]) >= 3.0, (mark, ground)


DEFICIENCIES = {  # Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                   [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                     [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                   [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


def lab(colour: RGB, deficiency: str) -> np.ndarray:
    """CIE L*a*b* (D65) of a colour as somebody with the deficiency sees it."""
    part = np.array(colour) / 255
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(DEFICIENCIES[deficiency]) @ linear, 0, 1)
    matrix = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = np.array(matrix) @ seen / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_individuals_are_told_apart_by_colour_blind_readers(deficiency: str) -> None:
    for theme in ("light", "dark"):
        seen = [lab(getattr(c, theme), deficiency) for c in (*PURSUERS[:3], TARGET)]
        gaps = [np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)]
        assert min(gaps) > 10, (theme, gaps)  # 2.3 is just noticed


def test_colours_stand_in_one_table() -> None:
    """Style sheets and scripts name variables; no figure has a colour that both themes share."""
    for path in TEMPLATES.iterdir():
        if path.suffix in (".css", ".js"):
            assert not re.search(r"#[0-9a-f]{3,8}\b(?![\w-]*\s*\{)", path.read_text()), path.name
    drawings = re.findall(r"<svg.*?</svg>", report_page(), re.DOTALL)
    plain = {
        found for drawing in drawings for found in re.findall(r"(?<!, )#[0-9a-f]{6}\b", drawing)
    }
    assert not plain


def test_a_drawing_takes_the_pages_colours() -> None:
    assert themed("fill: #2b2b2f; stroke: #123456") == (
        "fill: var(--text, #2b2b2f); stroke: #123456"
    )


# -- words ----------------------------------------------------------------------------------------


def test_nothing_is_printed_as_none_or_nan(page: Page) -> None:
    for text in page.texts:
        assert not re.search(r"\b(None|nan|NaN|inf|undefined)\b", text), text
    assert "not set" in page.texts  # an option that is absent
