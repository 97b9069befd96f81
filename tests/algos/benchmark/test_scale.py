"""What the benchmark costs can be measured for every cell that there is."""

from __future__ import annotations

from animarl_algos.benchmark.matrix import plan, read_matrix
from animarl_algos.learner.presets import constructed
from animarl_algos.recipes.registry import named_recipe
from benchmarks import scale


def test_every_learner_has_two_sizes_in_whole_rounds() -> None:
    units = []
    for cell in plan(read_matrix("short").changed(seeds=(0,))).cells:
        if cell.settings is None or not named_recipe(cell.method).algorithm.recipe.online:
            continue
        less, more = scale.few_steps(cell.settings)
        assert more == 3 * less >= 3 * scale.STEPS, cell
        learner = cell.settings.learner()
        every, unit = constructed(learner.arguments)["train_freq"]
        units.append(unit)
        assert unit == "episode" or less % (every * learner.n_envs) == 0, cell
    assert {"episode", "step"} <= set(units)


def test_cells_are_taken_in_turn_by_whoever_is_free() -> None:
    assert scale.makespan([3.0, 1.0, 1.0, 1.0], 2) >= 3.0
    assert scale.makespan([1.0] * 4, 1) > scale.makespan([1.0] * 4, 2)
