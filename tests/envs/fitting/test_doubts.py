"""What is doubtful of a fit, and what of a run: said where it holds, silent where it does not."""

from dataclasses import replace

import numpy as np
import pytest
from moving_pairs import recorded_pairs, simulated_pairs
from test_fitting import simulate

from animarl_algos.evaluation.verdict import implausible, verdict
from animarl_envs.fitting import LocomotionFit, fit_locomotion
from animarl_envs.fitting.result import doubts


def test_a_good_fit_is_not_doubted() -> None:
    demos, _ = simulate(2, episodes=120, noise=5e-4)
    assert doubts(fit_locomotion(demos, bootstrap=200), demos) == []


def test_a_fit_that_hangs_on_the_left_out_steps_is_told_both_ways() -> None:
    demos, _ = simulate(2, episodes=60, noise=5e-4, jumps=0.002)
    fit = fit_locomotion(demos, bootstrap=200)
    (found,) = [sentence for sentence in doubts(fit, demos) if "tracking jumps" in sentence]
    for one in fit.individuals:
        assert f"{one.name}: d is {one.damping:.3g} and u {one.thrust:.3g} without" in found


def changed(fit: LocomotionFit, **fields: object) -> LocomotionFit:
    first = replace(fit.individuals[0], **fields)  # type: ignore[arg-type]
    return replace(fit, individuals=(first, *fit.individuals[1:]))


def test_terminal_speeds_and_intervals_are_doubted_beyond_their_limits() -> None:
    demos, _ = simulate(1)
    fit = fit_locomotion(demos, bootstrap=0)
    top = fit.individuals[0].top_speed
    assert not any("top speed" in s for s in doubts(changed(fit, terminal_speed=1.9 * top), demos))
    (fast,) = doubts(changed(fit, terminal_speed=2.5 * top), demos)
    assert fast.startswith("With the thrust held a would") and "2.5 times the top speed" in fast
    low, high = 0.9 * fit.individuals[0].damping, 1.1 * fit.individuals[0].damping
    assert doubts(changed(fit, damping_interval=(low, high)), demos) == []
    (zero,) = doubts(changed(fit, damping_interval=(0.0, high)), demos)
    assert "The interval of d reaches 0 for a," in zero


def test_a_doubt_is_said_once_for_all_individuals() -> None:
    demos, _ = simulate(1)
    fit = fit_locomotion(demos, bootstrap=0)
    every = [replace(one, damping_interval=(0.0, 1.0)) for one in fit.individuals]
    (zero,) = doubts(replace(fit, individuals=tuple(every)), demos)
    assert f"for {', '.join(one.name for one in every)}, so" in zero


@pytest.mark.parametrize(
    ("kind", "words"),
    [("true", []), ("slow", ["Median speed"]), ("dead", ["Duration"]), ("still", ["Median speed"])],
)
def test_what_is_off_by_more_than_half_is_said(kind: str, words: list[str]) -> None:
    demos = recorded_pairs()
    found = implausible(verdict(demos, simulated_pairs(demos, kind), seed=0, references=demos))
    assert all("off by more than half" in sentence for sentence in found)
    for word in words:
        assert any(sentence.startswith(word) for sentence in found)
    if not words:
        assert found == []


def test_a_network_that_training_made_worse_is_said_first() -> None:
    demos = recorded_pairs()
    dead, true = simulated_pairs(demos, "dead"), simulated_pairs(demos, "true")
    worse = verdict(demos, dead, seed=0, baselines={"untrained": true}, references=demos)
    assert implausible(worse)[0].startswith("An untrained network comes nearer")


def test_a_share_that_was_never_recorded_is_off_only_where_it_is_common() -> None:
    demos = recorded_pairs()
    never = replace(demos, outcome=np.zeros(len(demos)))
    simulated = simulated_pairs(demos, "true")
    outcome = np.zeros(len(simulated))
    outcome[: len(outcome) // 20] = 1
    rare = replace(simulated, outcome=outcome)
    often = replace(simulated, outcome=np.ones(len(simulated)))
    said = [
        [s for s in implausible(verdict(never, one, seed=0, references=never)) if "reached" in s]
        for one in (rare, often)
    ]
    assert said == [[], ["Target reached is off by more than half: 100 % simulated, 0 % recorded."]]
