"""Simulated tracks that stand for the recordings of a model that is given away without these."""

from dataclasses import replace

import numpy as np

from animarl_algos.runs.run import Run
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import LEARNED_FROM, unit_of
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import STATED, stated_options
from animarl_envs.species import ChaseSpecies

EPISODES = {"train": 40, "val": 10, "test": 30}
"""Most tracks of each split."""
SETTLING = 1.0  # what is left out of a chase, which contact may end soon [s]; of others, half
KEPT = ("licence", "citation", "set", "unit", "recipe", "conditions")


def simulated_recordings(run: Run) -> Demonstrations:
    """Return tracks that a run's policy simulates, to stand for its recordings.

    They begin where the simulated animals are some time after a recorded start, so that they hold
    no recorded position, and state what was measured of the recordings.

    Raises
    ------
    InputError
        If the animals search a source, have headings or did not all learn.
    """
    species, demos = run.species, run.demos
    if not isinstance(species, ChaseSpecies) or species.has_headings or run.settings.focal:
        raise InputError(
            f"{run.path}: simulated tracks cannot stand for the recordings of animals that search "
            "a source, have headings or did not all learn: use --with-demonstrations"
        )
    rng = np.random.default_rng(run.settings.seed)
    chosen = [
        rng.permutation(np.flatnonzero(demos.split == split))[:most]
        for split, most in EPISODES.items()
    ]
    starts = demos.select(episodes=np.concatenate(chosen))
    rollouts = run.roll_out(
        run.policy,
        run.settings.algo,
        "actual" if run.has_condition_flag else None,
        scenario=run.starting_from(None, demos=starts),
        repetitions=1,
    )
    left_out = np.full(len(rollouts), max(1, round(SETTLING / species.dt)))
    if species.free:
        left_out = np.maximum(1, rollouts.lengths // 2)
    kept = np.flatnonzero(rollouts.lengths - left_out >= Demonstrations.FEWEST_FRAMES)
    paths = [rollouts.path(i) for i in kept.tolist()]
    first = left_out[kept]
    names = [f"simulated_{number:02d}" for number in range(len(kept))]
    provenance = {key: demos.provenance[key] for key in KEPT if key in demos.provenance}
    source, scale = demos.provenance["source"], {"unit": unit_of(demos).per_arena_unit}
    return replace(
        starts.select(rollouts.demo[kept]),
        # Single precision halves the file.
        positions=np.concatenate([path[at:] for path, at in zip(paths, first)]).astype(np.float32),
        lengths=rollouts.lengths[kept] - first,
        initial_velocity=np.array([path[at] - path[at - 1] for path, at in zip(paths, first)])
        / demos.dt,
        outcome=rollouts.outcome[kept],
        recording=np.array(names),
        signals={},
        provenance=provenance
        | {
            "source": f"simulated by a model that learned from {source}",
            "synthetic": True,
            LEARNED_FROM: source,
            STATED: stated_options(species) | {"title": "Simulated animals"},
            "scales": dict.fromkeys(names, scale),
        },
    )
