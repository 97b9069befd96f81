"""By which rule the trained policies of a run act: asked for, or chosen after training and kept."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

from animarl_algos.data.slots import FocalPolicy, focal_drivers
from animarl_algos.evaluation.acting_choice import (
    candidate_rules,
    choice_episodes,
    choose_acting,
    further_rules,
)
from animarl_algos.evaluation.collect import Policy
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.runs.run_folder import RunFolder
from animarl_algos.runs.run_settings import CHOSEN
from animarl_algos.runs.run_world import in_the_world
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.scenario import make_scenario
from animarl_envs.species import Species
from animarl_envs.worlds import make_world


def acting_file(run: RunFolder, algo: str) -> Path:
    """Where the rule that was chosen stands, with the candidates it was chosen from."""
    return run.path / "policies" / f"{algo}.acting.json"


def acting_of(run: RunFolder, algo: str) -> Acting:
    """The rule that the trained ``algo`` of a run acts by.

    Raises
    ------
    InputError
        If none was chosen yet, or the file is damaged.
    """
    asked = run.acting_rule or run.settings.acting
    if asked != CHOSEN:
        return Acting.parse(asked)
    file = acting_file(run, algo)
    try:
        return Acting.from_json(json.loads(file.read_text())["acting"])
    except FileNotFoundError:
        raise InputError(
            f"{file}: no acting rule was chosen yet: let 'animarl train' finish, or give --acting"
        ) from None
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{file}: it is damaged ({error}): remove it and train again") from None


def act_as_chosen(
    run: RunFolder, algo: str, model: SequenceQLearning, species: Species
) -> SequenceQLearning:
    """The trained ``model``, acting by its rule, which is chosen where there is none yet."""
    asked, file = run.acting_rule or run.settings.acting, acting_file(run, algo)
    if asked == CHOSEN and not file.exists():
        _choose(run, model, species, file)
    model.policy.acting = acting_of(run, algo)
    return model


def _choose(run: RunFolder, model: SequenceQLearning, species: Species, file: Path) -> None:
    settings = run.settings
    demos = choice_episodes(run.learnable_demos, settings.seed)
    drivers = focal_drivers(species.individuals, settings.focal)
    senses = in_the_world(run.environment_options)
    scenario = make_scenario(species, demos=demos, split=None, drivers=drivers, **senses)

    def acting_by(rule: Acting) -> Policy:
        model.policy.acting = rule
        model.policy.seed(settings.seed)
        return for_all(model, scenario.names, settings.focal)

    fitted = model.fit_temperature(model.demonstration_data().val)
    choice = choose_acting(
        acting_by,
        partial(make_world, scenario),
        demos,
        candidate_rules(fitted),
        further_rules(fitted),
        seed=settings.seed,
        cue="actual" if model.layout.condition_flag else None,
    )
    with write_then_rename(file) as part:
        part.write_text(json.dumps(choice.to_json(), indent=2) + "\n")


def for_all(policy: Policy, names: tuple[str, ...], focal: str | None) -> Policy:
    """A policy that is asked for all individuals, also where it learned for ``focal`` alone."""
    if focal is None or not isinstance(policy, SequenceQLearning):
        return policy
    return FocalPolicy(policy, names, focal)
