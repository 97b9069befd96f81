"""Options of :class:`~animarl_algos.data.vec_env.SlotVecEnv`: its own, and the scenario's."""

SCENARIO_OPTIONS = ("condition", "start", "observation_noise", "observation_delay")
OWN_OPTIONS = (
    "split", "focal", "condition_flag", "cue", "dtw", "labels", "label_width", "label_horizon",
)  # fmt: skip
