"""What the environment pages say about each option: allowed values, and what it means.

Names and defaults are not written here; they come from the signatures and the species specs, and a
test compares the two lists.
"""

from __future__ import annotations

from animarl_envs.locomotion import MOST_THRUSTS

POSITIVE = "a positive number"
NOT_NEGATIVE = "zero or a positive number"

NOTES: dict[str, tuple[str, str]] = {
    "focal": (
        "a name of an individual",
        "the one that you control; by default the first pursuer",
    ),
    "others": (
        "`'replay'`, `'scripted'`, `'packaged'` (agents, flies, newts: "
        "[trained opponents](../pretrained.md#trained-opponents)), `'coast'`, a function from "
        "observations to actions, or a mapping from names to these",
        "how the others move; by default they replay their demonstration, or follow their script "
        "where there is none and in tasks",
    ),
    "render_mode": ("`'rgb_array'`, `'human'`, `None`", "pictures as arrays or in a window"),
    "demos": (
        "`'packaged'`, a file, a `Demonstrations`, `None`",
        "demonstrations: episodes start from them and are compared with them",
    ),
    "split": (
        "`'train'`, `'val'`, `'test'`, `None`",
        "which split of the demonstrations; `None` for all",
    ),
    "condition": ("`0`, `1`, `'demo'`", "experimental condition; `'demo'`: the demonstration's"),
    "start": (
        "`'demo'`, `'uniform'`, an array (individuals, 2)",
        "first positions; by default those of the demonstration, if there is one",
    ),
    "observation_noise": (NOT_NEGATIVE, "standard deviation of noise on every component"),
    "observation_delay": ("a whole number of steps", "how old the returned observation is"),
    "arena": (
        "an `Arena`, its fields by name, `'square'`, `'disc'`, `'open'`, `'ring=0.6'` (a disc with "
        "a hole of .6 of its radius), `'rectangle=0.5'`, `'polygon=-1,-1;1,-1;0,1'`, or a size",
        "shape and size of the field; the boundary and the square of starts grow with a size",
    ),
    "boundary": (
        "at least the size of the arena",
        "size beyond which an individual is out, if there are no walls",
    ),
    "rebound": (
        "`True`, `False`",
        "walls at the arena's size, along which individuals slide; without walls, "
        "leaving the boundary ends the episode",
    ),
    "locomotion": (
        "a `Locomotion`; or by name a `Locomotion`, `{'damping': d, 'thrust': u, 'magnitudes': "
        "(1.5, 0.5)}` or a factor on u",
        "damping d, thrust u and thrust magnitudes (multiples of u); M magnitudes make 12 M + 1 "
        "actions",
    ),
    "thrusts": (
        f"a whole number, 1 to {MOST_THRUSTS}",
        "number of thrust magnitudes: fixed multiples of u (3: 1.75, 1 and 0.5); for your own "
        "animals they are fitted",
    ),
    "contact_radius": (POSITIVE, "distance below which there is contact"),
    "dt": (POSITIVE, "decision step [s]"),
    "time_limit": ("a whole number of steps, at least 1", "steps until the episode is truncated"),
    "warmup": ("a whole number of steps", "steps replayed from the demonstration at the start"),
    "conditions": ("none or two names", "names of conditions 0 and 1"),
    "observation": (
        "`'compact'`, `'full'`, `'paper'`",
        "what is observed: a few numbers, those that clones need, or those of the paper",
    ),
    "sense_scales": (
        "`SenseScales` or `None`",
        "scales of the inputs of a policy that was trained in another world; `None`: those of this "
        "world",
    ),
    "traits": (
        "`Traits`, `None`",
        "in which individuals differ from each other; fitted for your own moths, and for your own "
        "animals without a target",
    ),
    "mirror_symmetric": ("`True`, `False`", "whether learners may mirror its episodes at random"),
    "bodies": ("one or two names", "drawing of all individuals, or of pursuers and target"),
    "boundary_penalty": ("a number", "reward of leaving the boundary"),
    "time_cost": (NOT_NEGATIVE, "what a whole episode costs a pursuer or searcher, in captures"),
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
    "landmarks": (
        "names and places, such as `{'stripe': (0, 1)}`",
        "points that individuals perceive by direction and distance",
    ),
    "obstacles": (
        "x, y and radius of each, such as `[(0.3, 0, 0.1)]`",
        "discs that nobody enters [arena unit]",
    ),
    "num_pursuers": (
        "a whole number, at least 1",
        "number of pursuers; with fewer than recorded, the first ones are used; with more, give "
        '`start="uniform"` or positions',
    ),
    "num_targets": (
        "a whole number, at least 1",
        "number of targets of a single pursuer, which is then the last individual; with "
        "demonstrations the first targets",
    ),
    "lone_pursuer": (
        "`True`, `False`",
        "the last individual pursues all others; set by `num_targets` and by a flock's "
        "demonstrations",
    ),
    "start_half_side": (POSITIVE, "starts without a demonstration are uniform in this square"),
    "senses_centre": (
        "`True`, `False`",
        "add the distance from the centre to `'paper'`",
    ),
    "senses_compass": (
        "`True`, `False`",
        "add places, velocities and directions in the frame of the arena; otherwise nothing in "
        "`'full'` depends on where north is",
    ),
    "senses_course": (
        "`True`, `False`",
        "add in which of the 12 directions it moves and thrusts (harmonics of the direction)",
    ),
    "senses_heading": (
        "`True`, `False`",
        "add where its own body and those of the others point; on for your own animals if a body "
        "does not point where it walks",
    ),
    "turning": (
        "by name or one for each: a `Turning`, `{'persistence': p, 'gain': g, 'slip': s, 'speed': "
        "v}`, `None`",
        "how bodies turn; `None`: they point where they walk; fitted for your own animals with "
        "recorded headings",
    ),
    "senses_past": (
        "`True`, `False`",
        "add its own velocity averaged over the last steps; on for your own animals with several "
        "thrusts",
    ),
    "senses_time": (
        "`True`, `False`",
        "add the time since the start; on for your own animals if each episode begins with a "
        "separation",
    ),
    "shared_reward": ("`True`, `False`", "whether a capture in condition 1 pays every pursuer"),
    "free": (
        "`True`, `False`",
        "nobody is pursued, and contact does not end an episode; on for your own animals without a "
        "target",
    ),
    "neighbours": (
        "a whole number, at least 0",
        "how many of its nearest neighbours a free animal sees",
    ),
    "shoaling_reward": (
        "`True`, `False`",
        "whether a free animal is paid for time within the contact radius of another [s]",
    ),
}

FREE_ONLY: dict[str, tuple[str, str]] = {
    "num_pursuers": (
        "a whole number, at least 1",
        "number of animals; with fewer than recorded, the first ones are used; with more, give "
        '`start="uniform"` or positions',
    ),
}

SEARCH_ONLY: dict[str, tuple[str, str]] = {
    "observation": (
        "`'compact'`, `'full'`, `'paper'`, `'odour'`",
        "the components above, all, those of the paper, or the two hits of the present step alone "
        "(`AnimaRL/SilkmothMemory-v0`: a task for policies with a memory)",
    ),
    "metres_per_unit": (POSITIVE, "length of an arena unit [m]"),
    "start_distance": (
        POSITIVE,
        "distance of the start downwind of the source, without a demonstration",
    ),
    "start_region": (
        "none, or lowest x, highest x, highest |y|",
        "starts without a demonstration are uniform in it, away from the source",
    ),
    "antenna_length": (POSITIVE, "distance of the antennae's tips ahead of the body's centre"),
    "antenna_angle": ("0 to 90", "angle of the antennae to either side [deg]"),
    "antenna_radius": (NOT_NEGATIVE, "radius within which an antenna meets the plume"),
    "odour_decay": (POSITIVE, "time constant of the signal after the last hit [s]"),
    "odour_baseline": ("0 to below 1", "signal without odour"),
    "trace_decay": (POSITIVE, "time constant of the slow trace of hits [s]"),
    "turning": (
        "a `Turning`, `{'persistence': p, 'gain': g, 'slip': s, 'speed': v}`, `None`",
        "how the body turns; `None`: it points where it walks",
    ),
    "senses_past": (
        "`True`, `False`",
        "add turning, way and speed averaged over the last 1 to 10 s and the time since a hit; on "
        "for your own recordings of odour",
    ),
    "flow_threshold": (NOT_NEGATIVE, "yaw rates below it give no visual flow [rad/s]"),
    "flow_limit": (POSITIVE, "visual flow is clipped here [rad/s]"),
    "rest_speed": (NOT_NEGATIVE, "without `turning`, the heading is kept when slower"),
    "plume": (
        "`'model'`, `'off'`, `'continuous'`, or a `Plume` from an array or a movie",
        "the odour plume",
    ),
    "train_plumes": ("plume patterns, 0 to 4", "patterns of training episodes"),
    "test_plumes": ("plume patterns, 0 to 4", "patterns of held-out episodes"),
}
