"""The fit of the programmed moth: within its bounds, repeatable, and better than where it began."""

from pathlib import Path

import numpy as np
import pytest

from animarl_envs.species import SILKMOTH
from animarl_envs.worlds.search.programmed_moth import MothProgramme
from tools.packaged_data import moth_fit
from tools.packaged_data.moth_searches import search
from tools.packaged_data.moth_statistics import of_demonstrations, of_searches, recorded_moths


def numbers(programme: MothProgramme) -> list[float]:
    """In the order of the bounds."""
    turns = dict(zip(("turn 1", "turn 2", "turn 3"), programme.turns, strict=True))
    return [turns.get(name) or getattr(programme, name) for name in moth_fit.BOUNDS]


def within_bounds(programme: MothProgramme) -> bool:
    low, high = np.array(list(moth_fit.BOUNDS.values())).T
    found = np.array(numbers(programme))
    return bool((found >= low * 0.99).all() and (found <= high * 1.01).all())


def test_the_bounds_name_every_number_of_the_programme() -> None:
    names = {name for name in moth_fit.BOUNDS if not name.startswith("turn ")} | {"turns"}
    assert names == set(vars(MothProgramme()))
    assert within_bounds(moth_fit.programme_of(moth_fit.start_point()))
    assert within_bounds(MothProgramme())


def test_a_fit_repeats_and_stays_within_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("EPISODES", 6), ("CANDIDATES", 4), ("PARENTS", 2)):
        monkeypatch.setattr(moth_fit, name, value)
    aim = of_searches(search(SILKMOTH, 0, episodes=20, seed=0))
    first, again, other = (moth_fit.fit(aim, 2, seed) for seed in (1, 1, 2))
    assert first == again != other
    assert within_bounds(first)
    assert first != moth_fit.programme_of(moth_fit.start_point())


@pytest.mark.realdata
def test_the_shipped_numbers_meet_the_aims_better(
    monkeypatch: pytest.MonkeyPatch, data_dir: Path
) -> None:
    monkeypatch.setattr(moth_fit, "EPISODES", 60)
    recorded = of_demonstrations(recorded_moths(data_dir / "silkmoth_mothvr"))
    shipped = moth_fit.losses(MothProgramme(), recorded, 1)
    middle = moth_fit.losses(moth_fit.programme_of(moth_fit.start_point()), recorded, 1)
    assert shipped.keys() == middle.keys()
    assert sum(shipped.values()) < 0.5 * sum(middle.values())
    assert shipped["speed"] < 1.0  # within the tolerance
