"""A chase of other animals is a spec: names, locomotion, arena, contact, time.

Any number of pursuers and one target live in the chase world, or with `lone_pursuer=True` one
pursuer and any number of targets. Numbers have units: lengths in arena
units, times in seconds or steps. Give the spec where a species is expected: to `gym.make` under any
id of the suite, to `gym.make_vec`, and to `parallel_env`.
"""

import gymnasium as gym

import animarl_envs
from animarl_envs.arena import Arena
from animarl_envs.locomotion import Locomotion
from animarl_envs.species import ChaseSpecies, Recording

HERDING = ChaseSpecies(
    name="custom",
    title="Two dogs and a sheep",
    individuals=("dog_0", "dog_1", "sheep"),
    locomotion=(Locomotion(0.2, 2.0), Locomotion(0.2, 1.8), Locomotion(0.3, 2.6)),
    arena=Arena("disc", size=2.0, boundary=2.2),
    contact_radius=0.15,
    dt=0.1,
    time_limit=200,  # steps
    recording=Recording(frame_rate=10.0, onset_threshold=0.3),
    source="made up",
)

if __name__ == "__main__":
    env = gym.make("AnimaRL/Agent-v0", species=HERDING, focal="sheep", demos=None)
    observation, info = env.reset(seed=0)
    everyone = animarl_envs.parallel_env(HERDING, demos=None)
    observations, infos = everyone.reset(seed=0)
    print(observation.shape, everyone.possible_agents)
