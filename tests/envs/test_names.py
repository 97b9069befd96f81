"""Names from files are data: shown, drawn and written as they are, or refused as names."""

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.drawing.summary_figure import plot_summary
from animarl_envs.errors import InputError, printable
from animarl_envs.importing.readers import read, read_tracks
from animarl_envs.importing.tracks import Tracks
from animarl_envs.settings import LONGEST_NAME, check_names
from tools.fuzz.layouts import BODIES, write_native

ODD = (
    "[/red]", "[bold]x", "[link=http://a.example]x[/link]", ":smile:", "<script>alert(1)</script>",
    "{{ 7 * 7 }}", "{% raise %}", "$\\frac{$", "a,b", 'a"b', "_hidden", "%s", "-1.5", "Käfer 3",
    "雀",
)  # fmt: skip
NO_NAMES = {
    "escape": "\x1b[31mred", "bell": "a\x07", "c1": "a\x9b31m", "surrogate": "a\udc80",
    "nul": "a\0b", "newline": "a\nb", "return": "a\rb", "backwards": "a\u202eb",
    "long": "a" * 5000, "empty": "", "blank": "  ", "up": "../../etc/passwd", "root": "/etc/passwd",
    "back": "..\\x", "formula": "=HYPERLINK(1)", "plus": "+1+1", "minus": "-1+1", "at": "@SUM(A1)",
}  # fmt: skip


def invoke(*words: str) -> Any:
    """Run the command line, where what it needs is installed."""
    testing = pytest.importorskip("typer.testing")
    from animarl_algos.cli.main import app

    with pytest.MonkeyPatch.context() as patch:  # no picture, which takes seconds
        patch.setattr("animarl_algos.cli.describing.find_spec", {"matplotlib": None}.get)
        return testing.CliRunner().invoke(app, list(words))


def table(path: Path, name: str) -> Path:
    """A long table of two animals, the first of which has the name."""
    with path.open("w", newline="", encoding="utf-8", errors="surrogateescape") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "id", "x", "y"])
        for t, bodies in enumerate(BODIES.tolist()):
            for who, (x, y) in zip((name, "other"), bodies, strict=True):
                writer.writerow([t, who, x, y])
    return path


@pytest.mark.parametrize("kind", NO_NAMES)
def test_what_cannot_be_among_names_is_refused(kind: str) -> None:
    for what in ("individual", "keypoint", "recording"):
        names = {"individuals": ("a",), "keypoints": ("b",), "recording": "c"}
        names[f"{what}s" if what != "recording" else what] = (
            (NO_NAMES[kind],) if what != "recording" else NO_NAMES[kind]
        )
        said = refuses("", Tracks, positions=np.zeros((3, 1, 1, 2)), **names)
        assert "rename it" in said or "give it" in said
        assert said.isprintable() and len(said) < 400


@pytest.mark.parametrize("kind", NO_NAMES)
def test_names_are_refused_in_tables_in_one_printable_sentence(kind: str, tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", NO_NAMES[kind])
    ran = invoke("import", str(path), "--fps", "20", "--dry-run")
    assert isinstance(ran.exception, InputError)
    lines = printable(str(ran.exception)).splitlines()
    assert all(line.isprintable() for line in lines) and "\x1b" not in ran.output


@pytest.mark.parametrize("kind", NO_NAMES)
def test_names_are_refused_in_demonstrations(kind: str, tmp_path: Path) -> None:
    demos = Demonstrations.load(write_native(tmp_path))
    name = NO_NAMES[kind]
    for changes in (
        {"individuals": (name, "x")}, {"species": name}, {"signals": {name: np.zeros(36)}},
        {"recording": np.array([name + "a" if kind == "nul" else name, "b", "c"])},
    ):  # fmt: skip
        refuses("", replace, demos, **changes)


@pytest.mark.parametrize("name", ODD)
def test_odd_names_are_shown_as_they_are(name: str, tmp_path: Path) -> None:
    """Through import, the screen, and back out of a table."""
    path, out = table(tmp_path / "t.csv", name), tmp_path / "demos.npz"
    made = invoke("import", str(path), "--fps", "20", "--target", "other", "--out", str(out))
    assert made.exit_code == 0, made.output
    assert invoke("data", "check", str(out)).exit_code == 0
    shown = invoke("data", "show", str(out))
    assert shown.exit_code == 0 and name in shown.output.replace("\n", "")
    back = tmp_path / "back.csv"
    assert invoke("data", "convert", str(out), "--out", str(back)).exit_code == 0
    (*_, tracks) = read_tracks(back, recording="recording")
    assert set(tracks.individuals) == {name, "other"}
    with back.open(newline="") as file:
        cells = {cell for row in csv.reader(file) for cell in row}
    assert not [c for c in cells if c[:1] in ("=", "+", "@")]
    if set(name) & set("<$&{_"):  # of those that a picture could take for something else
        plot_summary(read(out), tmp_path / "p.svg")
        assert "<script>" not in (tmp_path / "p.svg").read_text()


@pytest.mark.slow
def test_names_stand_escaped_in_the_report() -> None:
    run_page = pytest.importorskip("animarl_algos.report.run_page").run_page
    from report_inputs import report_inputs

    inputs = report_inputs()
    odd = "<script>alert(1)</script>{{ 7 * 7 }}"
    html = run_page(replace(inputs, title=odd)).html()
    assert "<script>alert" not in html and "{{ 7 * 7 }}" in html and "&lt;script&gt;" in html


def test_texts_of_files_are_not_obeyed_by_the_screen(tmp_path: Path) -> None:
    """Provenance is free text, so it is shown with all that cannot be printed written out."""
    demos = Demonstrations.load(write_native(tmp_path))
    said = {"source": "\x1b]0;owned\x07 [bold]a\udc80[/red]", "licence": ["x"], "synthetic": True}
    path = replace(demos, provenance=said).save(tmp_path / "said.npz")
    shown = invoke("data", "show", str(path))
    assert shown.exit_code == 0, shown.output
    assert r"\x1b]0;owned\x07 [bold]a\udc80[/red]" in shown.output
    from animarl_algos.cli.shared import PlainConsole

    stream = io.StringIO()
    PlainConsole(file=stream).print("[red]\x1b[2J:smile:")
    assert stream.getvalue().strip() == r"[red]\x1b[2J:smile:"


def test_names_up_to_their_length_are_taken() -> None:
    check_names("here", "an animal", ["a" * LONGEST_NAME, "a/b", "male 1", "-1.5", "(=)"])
    with pytest.raises(InputError, match="here: an animal has a name of 201 characters"):
        check_names("here", "an animal", ["a" * (LONGEST_NAME + 1)])
    assert printable("a\tb\nc") == "a\\tb\nc"
