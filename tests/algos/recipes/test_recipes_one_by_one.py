"""The recipes train each individual as if it were alone: what is stacked does not mix."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
import toys
from pair_learners import SETTINGS, demonstrations, make_pair_learner

from animarl_algos.recipes.registry import named_recipe


@pytest.fixture
def in_double() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.parametrize("name", ["bc", "dqaas", "dqdil-pt", "qr-dqdil-pt"])
def test_individuals_together_are_individuals_alone(name: str, in_double: None) -> None:
    """Offline, from the same demonstrations and seed: the same weights, to rounding.

    In double precision: Adam divides by the size of the gradient, so that rounding of a gradient
    near zero makes steps as large as any.
    """

    class Alone(toys.Recall):
        num_observations = 4

    together = make_pair_learner(name)
    together.pretrain()
    for k, who in enumerate(toys.Pair.individuals):
        env = Alone(2)
        env.individuals = (who,)
        settings = SETTINGS | {"offline_epochs": 2}
        alone = named_recipe(name).algorithm(
            "GruPolicy", env, demonstrations=demonstrations(individuals=(who,)), **settings
        )
        run = alone.pretrain()
        for whole, single in zip(together.offline_progress.history, run.history, strict=True):
            assert whole[f"val/mean_rank/{who}"] == pytest.approx(single["val/mean_rank"])
        assert run.best_epochs == together.offline_progress.best_epochs[k : k + 1]
        mine, own = together.q_net.parameters(), alone.q_net.parameters()
        for stacked, single in zip(mine, own, strict=True):
            torch.testing.assert_close(stacked[k], single[0], atol=1e-10, rtol=1e-10)
