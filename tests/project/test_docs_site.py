"""The documentation site builds offline without a warning, tutorials and live pages included."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

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
    assert (out / "searchindex.js").exists()
    for name in ("own_tracks", "environments"):
        (file,) = out.glob(f"_downloads/*/{name}.ipynb")
        cells = [one for one in json.loads(file.read_text())["cells"] if one["cell_type"] == "code"]
        assert len(cells) >= 5 and all(one["execution_count"] for one in cells)


def test_docs_site_lists_every_page_once() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    listed = re.findall(r"^([\w/]+)$", index, re.MULTILINE)
    assert len(listed) == len(set(listed))
    for name in listed:
        assert name.startswith("_generated/") or (ROOT / "docs" / f"{name}.md").is_file(), name
    for page in (ROOT / "docs").glob("*.md"):
        assert page.stem in listed or page.name in ("index.md", "registry.md"), page.name
