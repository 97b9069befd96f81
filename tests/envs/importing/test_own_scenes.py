"""Own scenes far from the origin, in pixels: inputs of networks, and the map of values."""

from pathlib import Path

import numpy as np
import torch
from small_runs import few, made

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.cleaning import Scaling
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.tracks import Tracks
from animarl_envs.worlds import demonstration_observations


def in_pixels(demos: Demonstrations) -> list[Tracks]:
    """Chases as a camera would give them: 25 px to a unit, the origin elsewhere."""
    return [
        Tracks(
            recording=f"r{one.index:02d}", individuals=demos.individuals,
            positions=25.0 * one.positions[:, :, None] + [425.0, -243.0],
            frame_rate=1 / demos.dt, outcome=one.outcome,
        )
        for one in demos
    ]  # fmt: skip


def imported(centre: tuple[float, float] | None) -> Demonstrations:
    """An open field, in which nobody said what an arena unit is."""
    scaling = Scaling(shape="open", centre=centre)
    recipe = ImportRecipe(target="prey", scaling=scaling)
    return demonstrations_from_tracks(in_pixels(few(test=3)), recipe)


def test_inputs_of_networks_are_centred_and_scaled_in_any_unit(tmp_path: Path) -> None:
    demos = imported(None)
    assert np.abs(demos.positions).max() <= 1.0 + 1e-9
    run = made(tmp_path, "soft-bc", demos=demos, species="custom", rolled_out=False)
    species = run.species
    model = run.learner("soft-bc", run.environment(demos))
    run.load_policy("soft-bc", model)
    train = demos.select(split="train")
    raw = demonstration_observations(species, train)
    network = model.policy.q_net
    mean, sd = (each[..., : raw.shape[-1]] for each in (network.input_mean, network.input_sd))
    seen = (torch.as_tensor(raw).transpose(0, 1) - mean) / sd  # without the condition's flag
    moving = seen.std(dim=1) > 1e-3
    assert moving.float().mean() > 0.9
    assert seen.mean(dim=1).abs().max() < 1.0  # mirrored chases count as well
    assert seen.std(dim=1)[moving].min() > 0.2
    assert 0.5 < float(seen.std(dim=1)[moving].median()) < 1.5
