"""What the environment pages say about each option: allowed values, and what it means.

Names and defaults are not written here; they come from the signatures and the species specs, and a
test compares the two lists.
"""

from __future__ import annotations

from animarl_envs.locomotion import MOST_THRUSTS

POSITIVE = "a positive number"
NOT_NEGATIVE = "zero or a positive number"

NOTES: dict[str, tuple[str, str]] = {
    "focal": ("a name of an individual", "who acts; by default the first that is no target"),
    "others": (
        "`'replay'`, `'scripted'`, `'coast'`, a function from observations to actions, or a "
        "mapping from names to these",
        "what moves the rest; by default their demonstration, without one their script",
    ),
    "render_mode": ("`'rgb_array'`, `'human'`, `None`", "pictures as arrays or in a window"),
    "demos": (
        "`'packaged'`, a file, a `Demonstrations`, `None`",
        "recorded episodes to start from and be paired with",
    ),
    "split": ("`'train'`, `'val'`, `'test'`, `None`", "which of them; `None` for all"),
    "condition": ("`0`, `1`, `'demo'`", "experimental condition; `'demo'`: the demonstration's"),
    "start": (
        "`'demo'`, `'uniform'`, an array (individuals, 2)",
        "first positions; by default the demonstration's, if there are any",
    ),
    "observation_noise": (NOT_NEGATIVE, "standard deviation of noise on every component"),
    "observation_delay": ("a whole number of steps", "age of the observation that is handed out"),
    "arena": (
        "an `Arena`, its fields by name, `'square'`, `'disc'`, `'open'`, or a size",
        "the field; with a size, the boundary and the square of starts grow alike",
    ),
    "boundary": (
        "at least the size of the arena",
        "the virtual boundary around it, where there are no walls",
    ),
    "rebound": (
        "`True`, `False`",
        "walls at the arena's size: who walks into one is held and slides along it; without them, "
        "whoever leaves the boundary ends the episode",
    ),
    "locomotion": (
        "a `Locomotion`; or by name a `Locomotion`, `{'damping': d, 'thrust': u, 'magnitudes': "
        "(1.5, 0.5)}` or a factor on u",
        "d, u and the multiples of u of the individuals; M multiples make 12 M + 1 actions",
    ),
    "thrusts": (
        f"a whole number, 1 to {MOST_THRUSTS}",
        "M of every individual, who gets fixed multiples of its u (of 3: 1.75, 1, 0.5); your own "
        "animals have them fitted",
    ),
    "contact_radius": (POSITIVE, "closer is contact"),
    "dt": (POSITIVE, "decision step [s]"),
    "time_limit": ("a whole number of steps, at least 1", "steps until the episode is truncated"),
    "warmup": ("a whole number of steps", "steps replayed from the demonstration at the start"),
    "conditions": ("none or two names", "names of conditions 0 and 1"),
    "observation": (
        "`'full'`, `'paper'`",
        "all that is listed above, or the components of the paper, of which some are constant",
    ),
    "sense_scales": (
        "`SenseScales` or `None`",
        "scales of a policy that was trained in another world; `None`: those of this one",
    ),
    "mirror_symmetric": ("`True`, `False`", "whether left and right are alike to it, for learners"),
    "bodies": ("one or two names", "what all look like in pictures, or pursuers and target"),
    "planned_flip": (
        "`(0, 1)`, `(1, 0)`, `None`",
        "condition of the world and the other one that is told, as the paper compares them",
    ),
    "boundary_penalty": ("a number", "reward of leaving the boundary"),
    "name": ("a word", "its name"),
    "title": ("text", "shown in pictures"),
    "individuals": (
        "different names",
        "pursuers first, the target last (with `lone_pursuer`: targets, the pursuer)",
    ),
    "recording": ("a `Recording`", "how it was recorded and cut"),
    "source": ("text", "where the numbers come from"),
    "version_history": ("a tuple of texts", "what changed"),
}

CHASE_ONLY: dict[str, tuple[str, str]] = {
    "num_pursuers": (
        "a whole number, at least 1",
        "how many pursue; with demonstrations the first ones; more than were recorded start "
        'anywhere (`start="uniform"`)',
    ),
    "num_targets": (
        "a whole number, at least 1",
        "of one pursuer: the individuals are then the targets and, last, the pursuer; with "
        "demonstrations the first ones, as above",
    ),
    "lone_pursuer": (
        "`True`, `False`",
        "the last individual pursues all others, as `num_targets` and a flock's demonstrations say",
    ),
    "start_half_side": (POSITIVE, "starts without a demonstration are uniform in this square"),
    "senses_centre": (
        "`True`, `False`",
        "`'paper'` has the distance from the centre too",
    ),
    "senses_compass": (
        "`True`, `False`",
        "places, velocities and directions in the frame of the arena; without them `'full'` holds "
        "nothing that depends on where north is",
    ),
    "senses_course": (
        "`True`, `False`",
        "in which of the directions of actions it goes and thrusts too, by harmonics",
    ),
    "senses_heading": (
        "`True`, `False`",
        "where its body and those of the others point too; your own animals do if one of them does "
        "not point where it walks",
    ),
    "turning": (
        "by name or one for each: a `Turning`, `{'persistence': p, 'gain': g, 'slip': s, 'speed': "
        "v}`, `None`",
        "how bodies turn; `None`: it points where it walks; your own animals as their recorded "
        "headings do",
    ),
    "senses_past": (
        "`True`, `False`",
        "own velocity averaged over the last steps too; your own animals with several thrusts do",
    ),
    "senses_time": (
        "`True`, `False`",
        "time since the start too; your own animals do if each episode begins with a separation",
    ),
    "shared_reward": ("`True`, `False`", "in condition 1 a capture pays every pursuer"),
}

SEARCH_ONLY: dict[str, tuple[str, str]] = {
    "metres_per_unit": (POSITIVE, "length of an arena unit [m]"),
    "start_distance": (POSITIVE, "of the start downwind of the source, without a demonstration"),
    "antenna_length": (POSITIVE, "of the antennae's tips ahead of the body's centre"),
    "antenna_angle": ("0 to 90", "of the antennae to either side [deg]"),
    "antenna_radius": (NOT_NEGATIVE, "within which an antenna meets the plume"),
    "odour_decay": (POSITIVE, "time constant of the signal after the last hit [s]"),
    "odour_baseline": ("0 to below 1", "signal without odour"),
    "trace_decay": (POSITIVE, "time constant of the slow trace of hits [s]"),
    "turning": (
        "a `Turning`, `{'persistence': p, 'gain': g, 'slip': s, 'speed': v}`, `None`",
        "how the body turns; `None`: it points where it walks",
    ),
    "flow_threshold": (NOT_NEGATIVE, "yaw rates below it give no visual flow [rad/s]"),
    "flow_limit": (POSITIVE, "visual flow is clipped here [rad/s]"),
    "rest_speed": (NOT_NEGATIVE, "without `turning`, the heading is kept when slower"),
    "plume": (
        "`'model'`, `'off'`, `'continuous'`, or a `Plume` from an array or a movie",
        "the odour",
    ),
    "train_plumes": ("plume patterns, 0 to 4", "patterns of training episodes"),
    "test_plumes": ("plume patterns, 0 to 4", "patterns of held-out episodes"),
}
