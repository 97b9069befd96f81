"""Artificial predators and prey (paper, "Artificial agent dataset")."""

from animarl_envs.arena import Arena
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.base import Recording
from animarl_envs.species.chase import ChaseSpecies

AGENT = ChaseSpecies(
    name="agent",
    title="Predators and prey",
    individuals=("predator_0", "predator_1", "prey"),
    locomotion=(Locomotion(0.25, 3.0),) * 3,  # the simulation's truth
    arena=Arena("square", size=1.0, boundary=1.1),
    contact_radius=0.1,
    dt=0.1,
    time_limit=148,
    conditions=("individual", "shared"),  # who is rewarded for a capture
    shared_reward=True,
    mirror_symmetric=False,  # their networks were trained without that in mind
    start_half_side=0.5,
    recording=Recording(frame_rate=10.0, onset_threshold=0.3),
    bodies=("predator", "prey"),
    source="Fujii et al., Artificial agent dataset; Tsutsui et al. 2024, eLife",
)
