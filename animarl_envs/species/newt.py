"""Two males courting a female Japanese fire-bellied newt (paper, "Newt dataset").

With the published d and u the newts are about three times too slow, because they were computed with
30 Hz differences over 0.1 s. They are the defaults because nothing better is public. Fit your own.

The packaged demonstrations are synthetic, not recorded: see ``docs/data/packaged_courtship.md``.
"""

from animarl_envs.arena import Arena
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.base import Recording
from animarl_envs.species.chase import ChaseSpecies

NEWT = ChaseSpecies(
    name="newt",
    title="Courting newts",
    individuals=("male_0", "male_1", "female"),
    locomotion=(Locomotion(0.011, 0.013), Locomotion(0.010, 0.014), Locomotion(0.014, 0.014)),
    arena=Arena("square", size=1.0, boundary=1.1, rebound=True),
    contact_radius=0.15,
    dt=0.1,
    time_limit=500,
    warmup=10,
    senses_course=True,
    version_history=(
        "v0: first release; the arena has walls, which hold who walks into them "
        "(`rebound=False`: leaving it ends the episode, as in the paper)",
    ),
    recording=Recording(
        frame_rate=30.0,
        smoothing_cutoff=2.0,
        onset_threshold=0.01,
        start_farther_than=1.0,
        end_closer_than=0.15,
        longest=50.0,
    ),
    bodies=("newt",),
    source="Fujii et al., Newt dataset and Table 1",
)
