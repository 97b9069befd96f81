"""A headless Chromium for tests of pages, where there is one.

It is looked for where systems put it, and then where ``playwright install chromium`` does;
``ANIMARL_CHROMIUM`` names another one.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


def executable() -> str | None:
    """A Chromium of the system, or nothing: playwright's own then."""
    named = os.environ.get("ANIMARL_CHROMIUM")
    found = (shutil.which(name) for name in ([named] if named else NAMES))
    return next((path for path in found if path), None)


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser; the test is skipped, with the reason, where there is none."""
    from playwright import sync_api as api

    with api.sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(
                executable_path=executable(), args=["--no-sandbox", "--disable-gpu"]
            )
        except api.Error as error:
            pytest.skip(f"no Chromium can be started here: {str(error).splitlines()[0]}")
        try:
            yield browser
        finally:
            browser.close()


def listen(page: Any, said: list[str]) -> Any:
    """The page, whose console, errors and requests to the network are put into ``said``."""
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda one: said.append(one.url) if one.url.startswith("http") else None)
    return page


CONTROLS = "a[href], button, select, input, summary, [tabindex='0']"
REACHED = """(selector) => {
  const all = [...document.querySelectorAll(selector)].filter(
    (one) => !one.disabled && one.checkVisibility({ visibilityProperty: true }));
  all.forEach((one, k) => { one.dataset.control = k; });
  return all.map((one) => one.outerHTML.slice(0, 80));
}"""
FOCUSED = """() => {
  const one = document.activeElement, { outlineStyle, outlineWidth } = getComputedStyle(one);
  return [one.dataset.control ?? "", outlineStyle !== "none" && parseFloat(outlineWidth) >= 2];
}"""


def unreachable_controls(page: Any) -> list[str]:
    """Controls that the Tab key does not reach, or that do not show that they have the focus."""
    controls = dict(enumerate(page.evaluate(REACHED, CONTROLS)))
    assert controls
    for _ in range(2 * len(controls)):
        page.keyboard.press("Tab")
        number, outlined = page.evaluate(FOCUSED)
        if number and outlined:
            controls.pop(int(number), None)
        if not controls:
            break
    return [*controls.values()]


def serious_findings(page: Any) -> list[str]:
    """What axe-core finds on a page that is serious or worse; skipped where it is not installed."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(page).response["violations"]
    return [
        f"{one['id']}: {one['nodes'][0]['html'][:120]}"
        for one in found
        if one["impact"] in ("serious", "critical")
    ]
