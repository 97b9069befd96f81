"""The site builds offline without a warning; its links, its search and a phone's width hold."""

import json
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest
from browser import chromium

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_docs_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("myst_nb", reason="the extra 'docs' is not installed")
    out = tmp_path / "html"
    built = subprocess.run(
        [
            *(sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"),
            *("-d", tmp_path / "doctrees", ROOT / "docs", out),
        ],
        capture_output=True, text=True,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr[-3000:]
    names = (ROOT / "tests" / "public_names.txt").read_text().splitlines()
    reference = (out / "_generated" / "api.html").read_text()
    learners = [
        name for name in names if name.startswith("animarl_algos.") and name.count(".") == 1
    ]
    assert all(f'id="{name}"' in reference for name in learners)
    for species in ("agent", "fly", "newt", "silkmoth"):
        page = (out / "live" / f"{species}.html").read_text()
        assert "<title>What if" in page and len(page) < 5_000_000
    assert re.search(r"steps/s", (out / "tutorials" / "environments.html").read_text())
    for page in out.rglob("*.html"):
        for link in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text(encoding="utf-8")):
            if not re.match(r"\w+:|//", link):
                assert (page.parent / unquote(link)).exists(), f"{page.name} links to {link}"
    for name in ("own_tracks", "environments"):
        (file,) = out.glob(f"_downloads/*/{name}.ipynb")
        cells = [one for one in json.loads(file.read_text())["cells"] if one["cell_type"] == "code"]
        assert len(cells) >= 5 and all(one["execution_count"] for one in cells)
    with chromium() as browser:
        opened = browser.new_page(viewport={"width": 390, "height": 844})
        opened.goto((out / "search.html").as_uri() + "?q=shoal")
        opened.wait_for_selector("#search-results li a", timeout=60_000)
        for name in ("index", "gallery", "environments/agent", "learners", "statistics"):
            opened.goto((out / f"{name}.html").as_uri())
            assert opened.evaluate("document.documentElement.scrollWidth") <= 390, name


def test_docs_site_lists_every_page_once() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    listed = re.findall(r"^([\w/]+)$", index, re.MULTILINE)
    assert len(listed) == len(set(listed))
    for name in listed:
        assert name.startswith("_generated/") or (ROOT / "docs" / f"{name}.md").is_file(), name
    for page in (ROOT / "docs").glob("*.md"):
        assert page.stem in listed or page.name in ("index.md", "registry.md"), page.name
