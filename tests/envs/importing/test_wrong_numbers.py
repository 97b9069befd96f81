"""No wrong number: what a cut or a short stretch would hide is refused and said.

What else would be read as other numbers, or at other times, is in the golden table of files.
"""

from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.importing.cutting import Cutting
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import follow, read, read_tracks
from tools.fuzz.layouts import (
    KINDS,
    write_termites,
    write_wide,
)

TEXTS = sorted(name for name, kind in KINDS.items() if kind.guard == "text")


@pytest.mark.parametrize("name", TEXTS)
def test_wrong_number_at_the_end_of_a_cut_text_is_refused(name: str, tmp_path: Path) -> None:
    """Cut anywhere in the last number, and right behind it."""
    kind = KINDS[name]
    path = kind.write(tmp_path)
    whole = path.read_bytes().rstrip(b"\r\n")
    for lost in range(4):
        path.write_bytes(whole[: len(whole) - lost])
        refuses(r"its last line does not end|cells, the header", read_tracks, path, kind.source)


def test_wrong_number_at_the_end_of_tables_beside_is_refused(tmp_path: Path) -> None:
    path = write_termites(tmp_path)
    index = tmp_path / "index.csv"
    index.write_text(index.read_text().rstrip("\n")[:-1])
    refuses("last line does not end", read_tracks, path)
    events = tmp_path / "events.csv"
    events.write_text("recording,start,end\nwide,0,1.5")
    recipe = ImportRecipe(frame_rate=20.0, cutting=Cutting(mode="events", events=str(events)))
    refuses("last line does not end", follow, recipe, [write_wide(tmp_path)])


def test_short_stretches_are_counted_and_do_not_hide_the_contact(tmp_path: Path) -> None:
    """Thirteen of one step each were dropped without a word, and no contact was found."""
    rng, lines = np.random.default_rng(0), ["recording,frame,id,x,y"]
    for number in range(8):
        near = np.concatenate([rng.uniform(20, 90, 29), [5.0]])
        for t, gap in enumerate(near):
            lines += [f"r{number},{t},hare,0,0", f"r{number},{t},hunter,{gap},{t % 3}"]
        for start in (40, 50):  # two frames in which both are seen
            for t in (start, start + 1):
                lines += [f"r{number},{t},hare,0,0", f"r{number},{t},hunter,70,{t % 3}"]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines) + "\n")
    demos = read(path, frame_rate=25.0, target="hare")
    assert demos.num_episodes == 8 and (demos.outcome == 1).all()
    assert all(one["too_short"] == 2 for one in demos.provenance["cleaning"].values())
