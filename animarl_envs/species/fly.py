"""Two males courting a female fruit fly in a round chamber (paper, "Fly dataset").

The packaged demonstrations are synthetic, not recorded: see ``docs/data/packaged_courtship.md``.
"""

from animarl_envs.arena import Arena
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.base import Recording
from animarl_envs.species.chase import ChaseSpecies

FLY = ChaseSpecies(
    name="fly",
    title="Courting flies",
    individuals=("male_0", "male_1", "female"),
    locomotion=(Locomotion(0.013, 0.143), Locomotion(0.017, 0.165), Locomotion(0.014, 0.156)),
    arena=Arena("disc", size=1.0, boundary=1.1, rebound=True),
    contact_radius=0.2,
    dt=0.1,
    time_limit=500,
    senses_centre=True,
    senses_compass=False,  # a round dish looks alike from all sides
    senses_course=True,
    version_history=(
        "v0: first release; the arena has walls, which hold who walks into them "
        "(`rebound=False`: leaving it ends the episode, as in the paper)",
    ),
    recording=Recording(
        frame_rate=30.0,
        smoothing_cutoff=2.0,
        onset_threshold=0.1,
        start_farther_than=0.3,
        end_closer_than=0.2,
    ),
    bodies=("fly",),
    source="Fujii et al., Fly dataset and Table 1",
)
