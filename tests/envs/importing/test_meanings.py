"""Whole tables whose meaning is known are read rightly, or refused: none is read wrongly."""

from pathlib import Path

import numpy as np
import pytest

from tools.fuzz.meanings import Meaning, count_meanings, draw_meaning, judge


def test_no_table_of_known_meaning_is_read_wrongly() -> None:
    counts, lines = count_meanings(60, workers=1, seed=1)
    assert counts["wrong"] == 0, "\n".join(lines)
    assert counts["right"] > 30


@pytest.mark.parametrize("place", ["positions", "rate", "animals", "recordings"])
def test_a_wrong_reading_is_counted_as_wrong(tmp_path: Path, place: str) -> None:
    drawn = (draw_meaning(np.random.default_rng([2, n])) for n in range(500))
    true = next(one for one in drawn if "both" in one.features)
    (name, walk), *_ = true.recordings[0].items()
    changed = {
        "positions": Meaning(true.text, ({**true.recordings[0], name: walk + 1.0},), true.rate, ()),
        "rate": Meaning(true.text, true.recordings, 2.0 * (true.rate or 1.0), ()),
        "animals": Meaning(true.text, ({**true.recordings[0], "more": walk},), true.rate, ()),
        "recordings": Meaning(true.text, true.recordings * 2, true.rate, ()),
    }[place]
    assert judge(tmp_path / "table.csv", true)[0] == "right"
    assert judge(tmp_path / "table.csv", changed)[0] == "wrong"
