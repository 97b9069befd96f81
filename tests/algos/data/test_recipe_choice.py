"""The recipe of a clone is chosen by the demonstrations: exact or not, many or few."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animarl_algos.data import recipe_choice
from animarl_algos.data.recipe_choice import (
    CLONINGS,
    FEW_EXACT,
    SEEN_SELDOM,
    action_miss,
    choose_recipe,
)
from animarl_algos.learner.presets import learner_preset
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError

PACKAGED = {
    "agent": "exact", "fly": "nearly-exact", "newt": "nearly-exact", "silkmoth": "search",
    "solo": "recorded-few", "shoal": "recorded-few",
}  # fmt: skip


def strangers(demos: Demonstrations, episodes: int = 500, **changes: Any) -> Demonstrations:
    """The first episodes of every split, as somebody's own."""
    chosen = np.concatenate(
        [np.flatnonzero(demos.split == s)[:episodes] for s in np.unique(demos.split)]
    )
    return replace(demos.select(episodes=np.sort(chosen)), species="custom", **changes)


def shaken(demos: Demonstrations, by: float) -> Demonstrations:
    """With tracking noise, of this standard deviation."""
    noise = np.random.default_rng(0).normal(0.0, by, demos.positions.shape)
    return replace(demos, positions=(demos.positions + noise).clip(-1.4, 1.4))


@pytest.mark.parametrize("species", PACKAGED)
def test_the_recipe_that_is_chosen_for_packaged_demonstrations(species: str) -> None:
    name = choose_recipe(load_packaged(species)).name
    assert name == PACKAGED[species]
    if name != "recorded-few":  # without demonstrations it is the same
        chosen = learner_preset("soft-bc", environment_id(species), cloning=name)
        assert chosen == learner_preset("soft-bc", environment_id(species))


def test_a_strangers_agents_get_the_recipe_that_is_chosen_for_agents() -> None:
    agents = strangers(load_packaged("agent"))
    assert choose_recipe(agents).name == "exact"
    digits = replace(agents, positions=agents.positions.round(4))
    assert choose_recipe(digits).name in ("exact", "nearly-exact")
    few = strangers(agents, 100)
    found = choose_recipe(few)
    assert found.name == "exact-few" and action_miss(few)[1] < FEW_EXACT
    assert f"few (below {FEW_EXACT})" in found.reason
    assert choose_recipe(shaken(few, 0.02)).name == "recorded-few"


def test_steps_of_recorded_animals_decide_on_dropout_and_epochs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    some = shaken(strangers(load_packaged("agent"), 40), 0.02)
    steps = action_miss(some)[1]
    monkeypatch.setattr(recipe_choice, "FEW_STEPS", steps)
    monkeypatch.setattr(recipe_choice, "SEEN_SELDOM", steps + 1)
    assert recipe_choice.choose_recipe.__wrapped__(some).name == "recorded"
    monkeypatch.setattr(recipe_choice, "SEEN_SELDOM", steps)
    found = recipe_choice.choose_recipe.__wrapped__(some)
    assert found.name == "recorded-many" and f"many (from {steps})" in found.reason
    monkeypatch.undo()
    few, plain, many = (
        learner_preset("soft-bc", "AnimaRL/Custom-v0", cloning=name)
        for name in ("recorded-few", "recorded", "recorded-many")
    )
    assert few.env_kwargs == plain.env_kwargs == many.env_kwargs
    told = [one.arguments["policy_kwargs"] for one in (few, plain, many)]
    assert [one.pop("dropout") for one in told] == [0.3, 0.1, 0.0]
    assert few.arguments == plain.arguments
    assert many.arguments == plain.arguments | {"offline_epochs": 60}
    # of many steps each is seen fewer than six times by the plain recipe
    drawn = plain.arguments["offline_kwargs"]["updates_per_epoch"]
    drawn *= plain.arguments["offline_epochs"] * plain.arguments["offline_batch_size"]
    assert drawn < 6 * SEEN_SELDOM


def test_what_was_chosen_stands_in_the_run(tmp_path: Path) -> None:
    few = strangers(load_packaged("agent"), 40)

    def opened(folder: str, **asked: Any) -> dict[str, Any]:
        settings = RunSettings(file="few", species="custom", steps=1, copies=1, **asked)
        record = pipeline.open_run(settings, tmp_path / folder, "test", few).record
        assert record == json.loads((tmp_path / folder / "settings.json").read_text())
        return record

    record = opened("chosen")
    assert record["settings"]["cloning"] == "exact-few"
    assert record["reasons"]["cloning"].startswith("actions miss by ")
    assert record["environment"]["labels"] == "hard"
    assert record["learner"]["policy_kwargs"]["dropout"] == 0.3
    assert opened("chosen") == record  # found again
    told = opened("told", overrides={"env_kwargs": {"labels": "soft"}})
    assert told["environment"]["labels"] == "soft"  # what is asked for goes over what is chosen
    assert told["learner"] == record["learner"]
    asked = opened("asked", cloning="recorded")
    assert asked["reasons"] == {} and asked["environment"]["labels"] == "tracking"
    assert opened("dqn", algo="dqn")["settings"]["cloning"] == "chosen"  # takes nothing of it


def test_a_recipe_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="cloning is 'exactly': choose among chosen, exact, exac"):
        RunSettings(species="fly", steps=1, cloning="exactly")
    assert len(set(CLONINGS)) == 7
