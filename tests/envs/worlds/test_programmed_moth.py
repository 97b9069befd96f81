"""The programmed moth: its sequence, its fit, and that it finds the source by its senses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.locomotion import COAST, Locomotion
from animarl_envs.species import SILKMOTH
from animarl_envs.worlds.search.programmed_moth import MothProgramme, ProgrammedMoth
from tools.packaged_data import moth_fit
from tools.packaged_data.moth_comparison import RECORDED_FIT
from tools.packaged_data.moth_statistics import of_demonstrations, recorded_moths, search_statistics

QUIET = MothProgramme(motor_noise=0.0, pace_spread=0.0, pause_rate=0.0, surge_speed=0.021)


def observation(
    *, odour: tuple[float, float] = (0.07, 0.07), body_angle: float = 0.0, wind: int | None = None
) -> np.ndarray:
    seen = np.zeros((1, 1, 10))
    seen[0, 0, 2:5] = body_angle, *odour
    if wind is not None:
        seen[0, 0, 6 + wind] = 1.0
    return seen


def moth(programme: MothProgramme = QUIET) -> ProgrammedMoth:
    return ProgrammedMoth(1, np.random.default_rng(0), programme=programme)


def test_zigzag_lengthens_and_ends_in_a_loop() -> None:
    """Turns after a hit on the left: left, right, left, then right for ever."""
    programme = replace(QUIET, surge=1.0, turns=(0.5, 1.0, 1.5))
    one = moth(programme)
    one.act(observation(odour=(1.0, 0.07)))
    sides = []
    for _ in range(20):
        one.act(observation())
        sides.append(int(np.sign(one.turned[0])))
    assert sides == [0, 1, -1, -1, 1, 1, 1] + [-1] * 13


def test_a_new_contact_starts_the_sequence_anew_and_reset_forgets() -> None:
    one = moth()
    for _ in range(3):
        one.act(observation(odour=(1.0, 1.0)))
        for _ in range(6):
            one.act(observation())
    assert one.act(observation(odour=(1.0, 1.0)))[0, 0] == 0
    one.reset()
    assert one.act(observation())[0, 0] == COAST


@pytest.mark.parametrize("locomotion", [SILKMOTH.locomotion[0], RECORDED_FIT])
def test_full_senses_find_the_source_more_often(locomotion: Locomotion) -> None:
    species = replace(SILKMOTH, locomotion=(locomotion,))
    full, reduced = (
        search_statistics(species, condition, episodes=256, seed=3) for condition in (0, 1)
    )
    assert full.rate > 0.8
    assert 0.2 < reduced.rate < 0.75
    low, high = full.interval()
    assert low > reduced.interval()[1]
    assert low < full.rate < high
    # Successful searches end at the source: at least the straight way was walked.
    assert (full.path[full.reached] > 0.2).all() and (full.path[full.reached] < 10).all()
    assert (full.duration[~full.reached] == 300.0).all()


def test_bad_programmes_are_refused() -> None:
    for change, says in (
        ({"surge": 0.0}, "surge is 0.0"), ({"turns": (1.0, -1.0)}, "turns are"),
        ({"motor_noise": -0.1}, "motor_noise"), ({"pause": -1.0}, "pause is -1.0"),
        ({"pace_spread": np.inf}, "pace_spread"), ({"careful": 2.0}, "careful"),
    ):  # fmt: skip
        refuses(says, replace, QUIET, **change)


def within_bounds(programme: MothProgramme) -> bool:
    low, high = np.array(list(moth_fit.BOUNDS.values())).T
    turns = dict(zip(("turn 1", "turn 2", "turn 3"), programme.turns, strict=True))
    found = np.array([turns.get(name) or getattr(programme, name) for name in moth_fit.BOUNDS])
    return bool((found >= low * 0.99).all() and (found <= high * 1.01).all())


def test_the_bounds_name_every_number_of_the_programme() -> None:
    names = {name for name in moth_fit.BOUNDS if not name.startswith("turn ")} | {"turns"}
    assert names == set(vars(MothProgramme()))
    assert within_bounds(moth_fit.programme_of(moth_fit.start_point()))
    assert within_bounds(MothProgramme())


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
