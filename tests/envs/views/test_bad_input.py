"""Bad input to an environment: one sentence that names it, in each of the three views."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from recordings import dogs, search
from refusals import refuses

import animarl_envs
from animarl_envs.arena import Arena
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError, UnknownOptionError
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.turning import Turning

MAKE: dict[str, Callable[..., Any]] = {
    "single": lambda name, **given: gym.make(animarl_envs.environment_id(name), **given),
    "vector": lambda name, **given: gym.make_vec(
        animarl_envs.environment_id(name), num_envs=3, **given
    ),
    "parallel": animarl_envs.parallel_env,
}
every_view = pytest.mark.parametrize("view", MAKE)
NAN = float("nan")
TURNING = Turning(persistence=0.2, gain=0.3, slip=0.3, speed=0.5)

REFUSED: list[tuple[str, dict[str, Any], str]] = [
    # unknown options
    ("agent", {"colour": "red"}, "option 'colour' is unknown for agent"),
    ("silkmoth", {"num_puffs": 3}, "option 'num_puffs' is unknown for silkmoth"),
    ("silkmoth", {"shared_reward": True}, "option 'shared_reward' is unknown for silkmoth"),
    ("fly", {"plume": "off"}, "option 'plume' is unknown for fly"),
    # contradictory options
    ("agent", {"demos": None, "start": "demo"}, "give demos="),
    ("agent", {"demos": None, "num_pursuers": 1, "start": np.zeros((3, 2))}, "of 2 individuals"),
    ("agent", {"demos": None, "individuals": ["a", "b"], "num_pursuers": 2}, "one of the two"),
    ("agent", {"demos": None, "arena": "open", "rebound": True}, "rebound contradicts"),
    ("agent", {"demos": None, "arena": "open", "boundary": 2.0}, "boundary contradicts"),
    ("agent", {"boundary": 0.5}, "boundary 0.5 lies inside the arena"),
    ("agent", {"warmup": 20, "time_limit": 10}, "warmup is 20"),
    ("agent", {"dt": 0.2}, "dt is 0.1 s, that of agent 0.2 s"),
    ("agent", {"demos": None, "contact_radius": 0.9}, "start_half_side"),
    ("agent", {"demos": None, "start_half_side": 1.5}, "start_half_side is 1.5"),
    ("silkmoth", {"demos": None, "arena": "disc"}, "a search is in the open"),
    # a condition for a species that has none
    ("fly", {"demos": None, "condition": 1}, "fly, which has no conditions"),
    ("newt", {"demos": None, "condition": 1}, "newt, which has no conditions"),
    ("agent", {"condition": 2}, "condition is 2: choose 0, 1 or 'demo'"),
    ("agent", {"condition": True}, "condition is True"),
    ("agent", {"conditions": ("one",)}, "give two names, or none"),
    # numbers out of their range or of no number
    *(
        ("agent", {name: value}, name)
        for name in ("contact_radius", "dt", "start_half_side", "observation_noise")
        for value in (-0.1, NAN, float("inf"), "wide", None)
    ),
    *(
        ("agent", {name: value}, name)
        for name in ("time_limit", "warmup", "observation_delay", "num_pursuers")
        for value in (-1, 2.5, "long", True)
    ),
    ("agent", {"boundary_penalty": NAN}, "boundary_penalty is nan"),
    ("agent", {"arena": -1.0}, "arena size is -1.0"),
    ("agent", {"landmarks": {"stripe": "0"}}, "landmark 'stripe' is at '0': give x and y"),
    ("agent", {"landmarks": {"a[b|c]": "0,1"}}, "landmark 'a[b|c]': use letters, digits"),
    ("silkmoth", {"landmarks": {"lamp": (0, 1)}}, "a searcher perceives no landmarks"),
    ("agent", {"arena": "triangle"}, "arena is 'triangle': choose square, disc"),
    ("agent", {"arena": {"form": "disc"}}, "arena has no 'form'"),
    ("agent", {"arena": [1, 2]}, "arena is [1, 2]"),
    ("agent", {"rebound": "yes"}, "rebound is 'yes'"),
    ("fly", {"senses_centre": 1}, "senses_centre is 1"),
    ("fly", {"senses_past": 1}, "senses_past is 1"),
    ("fly", {"senses_time": "yes"}, "senses_time is 'yes'"),
    # locomotion
    ("agent", {"locomotion": {"wolf": 1.2}}, "locomotion names 'wolf'"),
    ("agent", {"locomotion": {"prey": -1.0}}, "thrust is -3.0"),
    ("agent", {"locomotion": {"prey": {"damping": 2.0}}}, "damping is 2.0"),
    ("agent", {"locomotion": {"prey": "fast"}}, "locomotion of prey is 'fast'"),
    ("agent", {"locomotion": (Locomotion(0.1, 1.0),) * 2}, "give one Locomotion"),
    # demonstrations
    ("agent", {"num_pursuers": 3}, "holds 2 pursuers: choose at most 2, or start='uniform'"),
    ("silkmoth", {"num_pursuers": 2}, "num_pursuers does not apply to silkmoth"),
    ("agent", {"split": "holdout"}, "split 'holdout' is unknown"),
    ("agent", {"demos": "absent.npz"}, "absent.npz: there is no such file"),
    ("agent", {"demos": 7}, "demos is 7"),
    ("silkmoth", {"demos": load_packaged("agent")}, "demonstrations of agent, not of silkmoth"),
    ("silkmoth", {"demos": replace(load_packaged("agent"), species="ant")}, "has one individual"),
    ("agent", {"start": "somewhere"}, "start is 'somewhere'"),
    ("agent", {"start": np.full((3, 2), 5.0)}, "start lies out of bounds"),
    ("agent", {"start": [["x", "y"]]}, "start is no array of numbers"),
    ("agent", {"demos": None, "num_targets": 0}, "num_targets is 0: it must be a whole number"),
    ("agent", {"demos": None, "num_targets": 2, "num_pursuers": 2}, "leave one of"),
    ("agent", {"demos": None, "individuals": ["a", "b"], "num_targets": 2}, "give one of the two"),
    ("agent", {"demos": None, "individuals": 3}, "give a name to each"),
    ("agent", {"demos": None, "individuals": "abc"}, "give a name to each"),
    ("agent", {"demos": None, "lone_pursuer": 1}, "lone_pursuer is 1: give true or false"),
    ("agent", {"num_targets": 2}, "holds 1 target: choose at most 1, or start='uniform'"),
    # demonstrations of one's own
    ("custom", {}, "give demos="),
    ("custom", {"demos": None}, "give demos="),
    ("custom", {"demos": 3}, "demos is 3"),
    ("custom", {"demos": "absent.npz"}, "absent.npz: there is no such file"),
    ("custom", {"demos": dogs(2), "num_pursuers": 3}, "dogs.npz holds 2 pursuers: choose at mo"),
    ("custom", {"demos": dogs(2), "num_pursuers": 0}, "num_pursuers is 0"),
    ("custom", {"demos": dogs(2), "num_pursuers": 1.5}, "num_pursuers is 1.5"),
    ("custom", {"demos": search(), "num_pursuers": 1}, "num_pursuers does not apply"),
    ("custom", {"demos": replace(dogs(2), species="fly", roles=("pursuer",) * 3)}, "--target"),
    ("custom", {"demos": replace(dogs(2), species="silkmoth")}, "do not fit silkmoth"),
    ("custom", {"demos": search(species="fly")}, "do not fit fly"),
    ("custom", {"demos": dogs(2), "condition": 1}, "condition"),
    ("custom", {"demos": dogs(2), "colour": 1}, "colour"),
    ("custom", {"demos": dogs(2), "contact_radius": -1}, "contact_radius"),
    # thrusts
    *((name, {"demos": load_packaged("fly"), "thrusts": thrusts}, ", 1 to 10")
      for name in ("fly", "custom") for thrusts in (0, -1, 11, 2.0, True, "3", [3])),
    *(("fly", {"thrusts": 3, "locomotion": moves}, "3 but locomotion gives magnitudes: leave one")
      for moves in ({"female": {"magnitudes": (2, 1)}}, Locomotion(0.1, 1.0, (2, 1)),
                    {"female": Locomotion(0.1, 1.0, (0.5,))},
                    [1.0, 1.0, Locomotion(0.1, 1.0, (2, 1))])),
    # headings
    *(("custom", {"demos": dogs(2), "turning": turning}, says) for turning, says in (
        ({"wolf": TURNING}, "turning names 'wolf': choose among dog_a, dog_b, sheep"),
        ((TURNING,), "give one for each of dog_a, dog_b, sheep"),
        (3, "turning is 3: give one for each"),
        ({"sheep": {"gain": 1.0}}, "name persistence, gain"),
        ((0.5, None, None), "turning of dog_a is 0.5: give a Turning"),
    )),
    ("custom", {"demos": dogs(2), "senses_heading": 1}, "senses_heading is 1: give true or false"),
    # what is seen
    ("fly", {"observation": "rich"}, "observation is 'rich': choose one of 'compact', 'full', 'pa"),
    # observations that would be infinite
    *(("agent", {"demos": None, "observation": "full"} | options, "float32 cannot hold: choose")
      for options in (
        {"locomotion": {"prey": {"thrust": 1e-320}}}, {"locomotion": {"prey": {"thrust": 1e308}}},
        {"locomotion": {"prey": {"magnitudes": (1e300,)}}}, {"arena": 1e200}, {"dt": 1e300},
        {"observation_noise": 1e300},
    )),
    # a search
    *(("silkmoth", {"demos": None, "start_region": region}, "give the lowest")
      for region in ((0.1, 0.0, 0.1), (0.0, 0.01, 0.01), (0.0, 0.4), "wide", 3)),
    ("silkmoth", {"odour_decay": 0.0}, "odour_decay"),
    ("silkmoth", {"trace_decay": 0.0}, "trace_decay"),
    ("silkmoth", {"antenna_angle": 120.0}, "antenna_angle"),
    ("silkmoth", {"train_plumes": ()}, "train_plumes"),
    ("silkmoth", {"observation": "most"}, "'full', 'paper'"),
    ("silkmoth", {"turning": 0.3}, "give a Turning"),
    ("silkmoth", {"turning": {"gain": 1.0}}, "persistence, gain, slip and speed"),
    ("silkmoth", {"turning": vars(TURNING) | {"persistence": 1.0}}, "below 1"),
    # the odour
    ("silkmoth", {"plume": "windy"}, "'model', 'off', 'continuous'"),
    ("silkmoth", {"odour_baseline": 1.0}, "odour_baseline is 1.0"),
    ("silkmoth", {"antenna_radius": -1.0}, "antenna_radius is -1.0"),
    ("silkmoth", {"train_plumes": (9,)}, "pattern 9 does not exist"),
    ("silkmoth", {"test_plumes": 3}, "test_plumes is 3"),
    # rendering
    ("agent", {"render_mode": "ascii"}, "render"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "options", "says"), REFUSED)
def test_refused_options(name: str, options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as refusal:
        MAKE["single"](name, **options)
    said = str(refusal.value)
    assert says in said and "\n" not in said
    assert "keyword argument" not in said or isinstance(refusal.value, UnknownOptionError)


@pytest.mark.parametrize("view", ["vector", "parallel"])
@pytest.mark.parametrize(("name", "options", "says"), REFUSED[::7])
def test_refused_options_of_the_other_views(
    view: str, name: str, options: dict[str, Any], says: str
) -> None:
    """Some of them: every view makes its scenario in one place."""
    refuses(re.escape(says), MAKE[view], name, **options)


@pytest.mark.parametrize(
    ("views", "options", "says"),
    [
        ("single vector", {"focal": "wolf"}, "focal is 'wolf'"),
        ("single vector", {"others": "dance"}, "'dance'"),
        ("single vector", {"others": {"wolf": "coast"}}, "others names 'wolf'"),
        ("single vector", {"others": {"predator_0": "coast"}}, "others names 'predator_0'"),
        ("single vector", {"others": {"prey": 3}}, "the rule 3"),
        ("single vector", {"demos": None, "others": "replay"}, "cannot replay"),
        ("single vector", {"drivers": {"prey": "coast"}}, "drivers is an option of parallel_env"),
        ("parallel", {"focal": "prey"}, "option 'focal' is unknown"),
        ("parallel", {"drivers": {"wolf": "coast"}}, "individual 'wolf' is unknown"),
        ("parallel", {"drivers": {"prey": "dance"}}, "prey is driven by 'dance'"),
        ("parallel", {"demos": None, "drivers": {"prey": "replay"}}, "cannot replay"),
    ],
)
def test_refused_roles_and_drivers(views: str, options: dict[str, Any], says: str) -> None:
    for view in views.split():
        refuses(says, MAKE[view], "agent", **options)


def test_refused_vectors() -> None:
    for options, says in (
        ({"num_envs": 0}, "num_envs is 0"),
        ({"num_envs": 1.5}, "num_envs is 1.5"),
        ({"num_envs": 2, "autoreset_mode": "Never"}, "NextStep"),
    ):
        refuses(says, gym.make_vec, "AnimaRL/Agent-v0", **options)


def _actions(view: str, env: Any, action: Any) -> Any:
    if view == "vector":
        return np.array([0, 0, action])
    return action if view == "single" else dict.fromkeys(env.possible_agents, action)


def _bare(view: str, **options: Any) -> Any:
    return MAKE[view]("agent", demos=None, **options).unwrapped


@every_view
def test_refused_step_before_reset(view: str) -> None:
    env = _bare(view)
    refuses("step was called before reset", env.step, _actions(view, env, 0))


@every_view
def test_refused_step_after_the_end(view: str) -> None:
    more = {"autoreset_mode": "Disabled"} if view == "vector" else {}
    env = _bare(view, time_limit=2, **more)
    env.reset(seed=0)
    for _ in range(2):
        env.step(_actions(view, env, 12))
    refuses("end", env.step, _actions(view, env, 12))
    env.reset()
    env.step(_actions(view, env, 12))


@every_view
@pytest.mark.parametrize("action", [13, -1, 3.7, NAN, "left", None])
def test_refused_actions(view: str, action: Any) -> None:
    env = _bare(view)
    env.reset(seed=0)
    before = env.world.position.copy()
    said = refuses("", env.step, _actions(view, env, action))
    assert "0 to 12" in said
    assert ("whole number" in said) == (type(action) is not int)
    assert np.array_equal(env.world.position, before)


@every_view
@pytest.mark.parametrize("kind", [np.int8, np.uint64, np.int64, np.array])
def test_actions_of_every_integer_type_are_the_same(view: str, kind: Any) -> None:
    env = _bare(view)
    rows = []
    for action in (3, kind(3)):
        env.reset(seed=0)
        env.step(np.array([action] * 3) if view == "vector" else _actions(view, env, action))
        rows.append(env.world.position.copy())
    assert np.array_equal(*rows)


def test_refused_action_shapes_and_names() -> None:
    vector, everyone = _bare("vector"), _bare("parallel")
    vector.reset(seed=0)
    everyone.reset(seed=0)
    for bad in ([0], [[0, 0, 0]], 0, [0, 0, 0, 0]):
        refuses(r"give \(3,\)", vector.step, np.array(bad))
    refuses("no action for predator_0: give one to each of p.*, prey", everyone.step, {"prey": 0})
    refuses("an action for 'wolf'", everyone.step, {**dict.fromkeys(everyone.agents, 0), "wolf": 1})
    refuses("actions are None: give one to each of predator_0", everyone.step, None)


@every_view
@pytest.mark.parametrize("demo", [400, -1, 1.5, "first"])
def test_refused_demonstration_at_reset(view: str, demo: Any) -> None:
    env = MAKE[view]("agent")
    refuses("demo", env.reset, seed=0, options={"demo": demo})


def test_a_demonstration_is_chosen_in_every_view() -> None:
    rows = [MAKE[view]("agent").reset(seed=0, options={"demo": 7}) for view in MAKE]
    (one, info), (many, infos), (named, spoken) = rows
    assert info["demo"] == spoken["prey"]["demo"] == 7
    assert infos["demo"].tolist() == [7, 7, 7]
    assert np.array_equal(one, named["predator_0"])
    assert all(np.array_equal(one, row) for row in many)
    some = MAKE["vector"]("agent")
    assert some.reset(seed=0, options={"demo": [3, -1, 5]})[1]["demo"][[0, 2]].tolist() == [3, 5]


def test_an_arena_may_be_named_by_its_fields() -> None:
    fields = {"shape": "disc", "size": 2.0, "boundary": 2.5, "rebound": True}
    env = MAKE["single"]("agent", demos=None, arena=fields).unwrapped
    assert env.scenario.species.arena == Arena(**fields)  # type: ignore[arg-type]


@every_view
def test_numbers_may_be_numpys(view: str) -> None:
    numbers = {
        "condition": np.int64(1), "observation_noise": np.float32(0.5),
        "observation_delay": np.int8(2), "time_limit": np.int32(9), "dt": np.float64(0.1),
        "contact_radius": np.float32(0.125), "arena": Arena("square", np.float64(1.0), 1.1),
    }  # fmt: skip
    env = MAKE[view]("agent", demos=None, **numbers)
    info = env.reset(seed=0)[1]
    said = env.scenario_data if view == "parallel" else info["scenario"]
    said = said[0] if view == "vector" else said
    assert [said[key] for key in numbers if key != "arena"] == [1, 0.5, 2, 9, 0.1, 0.125]


@pytest.mark.parametrize("kind", [InputError, UnknownOptionError])
def test_an_error_that_is_made_anew_of_itself_is_the_same_sentence(kind: Any) -> None:
    """As Gymnasium's process vectors raise it."""
    assert str(kind(kind("action 99 is out of range"))) == "action 99 is out of range"
