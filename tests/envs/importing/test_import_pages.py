"""Every line that can be copied from the pages on data runs, and the fitting table is current."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from pages import load_script, run_programs
from slow import slowly

from animarl_envs.importing.readers import registry
from tools.fuzz.layouts import KINDS, POSE, write_slp

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGES = DOCS / "data"
WITH_FILES, WITH_DATA = ("README.md", "readers.md"), "../gallery.md"


def console_lines(page: str, *parts: int) -> list[list[str]]:
    """The words of each line after ``$ animarl`` in a page, or under some of its headings."""
    texts = (PAGES / page).read_text().split("\n## ")
    text = "\n".join([texts[1 + part] for part in parts] or texts)
    blocks = re.findall(r"```console\n(.*?)```", text, flags=re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    assert lines and all(line.startswith("$ animarl ") for line in lines)
    return [shlex.split(line.removeprefix("$ animarl ")) for line in lines]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory that holds a file of every layout."""
    for name, kind in KINDS.items():
        own = tmp_path / "made" / name
        own.mkdir(parents=True)
        kind.write(own)
        shutil.copytree(own, tmp_path / "here", dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "here" / "benchmarks").symlink_to(DOCS.parent / "benchmarks")
    return tmp_path / "here"


@pytest.mark.parametrize("page", WITH_FILES)
def test_import_lines_of_the_page_run(page: str, folder: Path) -> None:
    longer = np.cumsum(np.random.default_rng(0).normal(0, 1, (200, 2, 1, 2)), axis=0)
    write_slp(folder, longer + POSE[0] - longer[0])
    for words in console_lines(page):
        assert animarl(*words).strip()
        if "--out" in words:
            assert (folder / words[words.index("--out") + 1]).exists()


def test_the_readers_page_has_a_line_for_every_reader(folder: Path) -> None:
    used = set()
    for words in console_lines("readers.md"):
        named = words[words.index("--source") + 1] if "--source" in words else None
        used.add(registry.find_reader(words[1], named).name)
    assert used == {reader.name for reader in registry.available_readers()}


@pytest.mark.realdata
@pytest.mark.parametrize("number", [0, 1, *slowly(2, 3, 4)])
def test_import_of_the_worked_examples(
    number: int, data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert len(re.findall(r"^## ", (PAGES / WITH_DATA).read_text(), flags=re.MULTILINE)) == 5
    for words in console_lines(WITH_DATA, number):
        given = [word.replace("$DATA", str(data_dir)) for word in words]
        given = [word.replace("benchmarks/", f"{DOCS.parent}/benchmarks/") for word in given]
        files = {w: sorted(map(str, Path(w).parent.glob(Path(w).name))) for w in given if "*" in w}
        words = [name for word in given for name in files.get(word, [word])]
        assert animarl(*words, drawn=True).strip()
    (recipe,) = tmp_path.glob("*.recipe.yaml")
    assert recipe.with_name(f"{recipe.name.removesuffix('.recipe.yaml')}.png").exists()


def test_python_of_the_reader_pages_runs() -> None:
    for page in ("cleaning.md", "readers.md"):
        run_programs(f"docs/data/{page}")
    assert "two-columns" in {reader.name for reader in registry.available_readers()}
    registry._READERS.pop("two-columns")


MAKER = load_script(DOCS / "make_fitting_table.py")


@pytest.mark.realdata
@pytest.mark.slow
@pytest.mark.parametrize("name", MAKER.SETS)
def test_reader_to_fit_joint_rmse_is_below_onset_rmse_and_in_the_table(
    name: str, data_dir: Path
) -> None:
    demos = MAKER.SETS[name](data_dir)
    onset, joint = MAKER.both_fits(demos)
    assert MAKER.pooled(joint) < MAKER.pooled(onset)
    page = (PAGES / "fitting.md").read_text()
    for row in MAKER.rows(name, demos):
        assert row in page


@pytest.mark.realdata
def test_reader_to_fit_joint_rmse_is_below_onset_rmse_of_moths_and_clip(data_dir: Path) -> None:
    for load in (MAKER.silkmoths, MAKER.sleap_clip, MAKER.fly_pair):
        onset, joint = MAKER.both_fits(load(data_dir))
        assert MAKER.pooled(joint) < MAKER.pooled(onset)
