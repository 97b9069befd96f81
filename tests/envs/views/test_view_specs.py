"""What Gymnasium and PettingZoo are told and tell: specs, infos, pictures, keys, resets."""

import inspect
from typing import Any

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.play import play
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TimeAwareObservation
from gymnasium.wrappers.vector import DictInfoToList, RecordVideo
from recordings import dogs
from refusals import refuses

import animarl_envs
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_envs.drawing.render import MOST_DRAWN, Renderer
from animarl_envs.errors import InputError
from animarl_envs.scenario import make_scenario
from animarl_envs.species import CUSTOM, SPECIES
from animarl_envs.views import AnimalEnv, AnimalParallelEnv, AnimalVectorEnv
from animarl_envs.wrappers import DTWReward

AGENT, SILKMOTH = "AnimaRL/Agent-v0", "AnimaRL/Silkmoth-v0"


@pytest.mark.parametrize("name", SPECIES)
def test_spec_says_the_longest_episode(name: str) -> None:
    env_id, limit = animarl_envs.environment_id(name), SPECIES[name].time_limit
    for given, said in ((None, limit), (limit + 100, limit + 100), (40, 40)):
        options = {} if given is None else {"time_limit": given}
        assert gym.make(env_id, **options).spec.max_episode_steps == said  # type: ignore[union-attr]
        assert gym.make_vec(env_id, num_envs=2, **options).spec.max_episode_steps == said  # type: ignore[union-attr]
    assert gym.make(env_id, max_episode_steps=7).spec.max_episode_steps == 7  # type: ignore[union-attr]
    assert gym.make_vec(env_id, num_envs=2, max_episode_steps=7).spec.max_episode_steps == 7  # type: ignore[union-attr]


def test_spec_of_own_animals_says_their_limit_and_lets_time_be_observed() -> None:
    own = gym.make("AnimaRL/Custom-v0", demos=dogs(2))
    assert own.spec is not None
    assert own.spec.max_episode_steps == own.unwrapped.time_limit  # type: ignore[attr-defined]
    env = TimeAwareObservation(gym.make(AGENT, demos=None), normalize_time=True)
    assert env.reset(seed=0)[0][-1] == 0.0
    assert env.step(12)[0][-1] == pytest.approx(1 / SPECIES["agent"].time_limit)


@pytest.mark.parametrize("most", [1, 7, 10, 11, 13])
def test_spec_limit_of_a_vector_is_that_of_singles_in_warm_up_too(most: int) -> None:
    assert SPECIES["silkmoth"].warmup == 10
    vector = gym.make_vec(SILKMOTH, num_envs=2, max_episode_steps=most)
    singles = [gym.make(SILKMOTH, max_episode_steps=most) for _ in range(2)]
    seen = vector.reset(seed=3)[0]
    assert np.array_equal(seen, [env.reset(seed=3 + b)[0] for b, env in enumerate(singles)])
    for t in range(1, most + 1):
        seen, _, terminated, truncated, infos = vector.step(np.array([0, 4]))
        for b, env in enumerate(singles):
            row, _, over, cut, info = env.step([0, 4][b])
            assert np.array_equal(row, seen[b])
            assert (over, cut) == (terminated[b], truncated[b]) == (False, t == most)
            assert info["warmup"] == infos["warmup"][b]
    assert np.array_equal(vector.step(np.array([0, 0]))[0], [env.reset()[0] for env in singles])


@pytest.mark.parametrize("most", [0, -1, 2.5, True, "7"])
def test_spec_limits_that_are_none_are_refused(most: Any) -> None:
    told = "max_episode_steps is .*: give a whole number"
    refuses(told, gym.make_vec, AGENT, num_envs=2, max_episode_steps=most)


@pytest.mark.parametrize("name", [*SPECIES, CUSTOM])
def test_spec_is_in_the_registry_of_pettingzoo(name: str) -> None:
    options = {"demos": dogs(2)} if name == CUSTOM else {}
    env = pettingzoo.make("parallel", animarl_envs.environment_id(name), **options)
    assert isinstance(env, AnimalParallelEnv)
    twin = animarl_envs.parallel_env(name, **options)
    seen, expected = env.reset(seed=1)[0], twin.reset(seed=1)[0]
    assert all(np.array_equal(seen[agent], expected[agent]) for agent in twin.possible_agents)


def test_spec_of_pettingzoo_takes_the_most_cycles() -> None:
    env = pettingzoo.make("parallel", AGENT, max_cycles=3)
    env.reset(seed=1)
    ends = [list(env.step(dict.fromkeys(env.agents, 12))[3].values()) for _ in range(3)]
    assert ends == [[False] * 3, [False] * 3, [True] * 3]
    assert env.agents == []


@pytest.mark.parametrize("mode", AutoresetMode)
def test_spec_of_infos_a_mask_for_every_entry_and_lists_equal_singles(mode: AutoresetMode) -> None:
    options = {"demos": None, "time_limit": 4}
    vector = gym.make_vec(AGENT, num_envs=2, autoreset_mode=mode, **options)
    vector, single = DictInfoToList(vector), gym.make(AGENT, **options)
    listed = vector.reset(seed=5)[1]
    assert listed[0].keys() == single.reset(seed=5)[1].keys() - {"warmup"}
    assert listed[0]["scenario"] == single.reset(seed=5)[1]["scenario"]
    for t in range(1, 5):
        listed = vector.step(np.array([0, 1]))[4]
        info = single.step(0)[4]
        ended = listed[0].pop("final_info", None)
        listed[0].pop("final_obs", None)
        assert (ended is not None) == (t == 4 and mode is AutoresetMode.SAME_STEP)
        assert (ended or listed[0]) == info


@pytest.mark.parametrize("copies", [1, 5, 11])
def test_spec_of_pictures_one_of_each_copy(copies: int) -> None:
    vector = gym.make_vec(AGENT, num_envs=copies, render_mode="rgb_array", time_limit=2)
    vector.reset(seed=0)
    vector.step(np.zeros(copies, dtype=int))
    pictures = vector.render()
    assert pictures is not None and len(pictures) == copies
    for pixels in pictures[:MOST_DRAWN]:
        assert pixels.shape == pictures[0].shape
        assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20
    assert all((blank == 255).all() for blank in pictures[MOST_DRAWN:])


def test_spec_of_pictures_is_kept_through_ends_of_episodes() -> None:
    """Copy 0 of a vector is drawn as a single environment is, in its second episode too."""
    options = {"render_mode": "rgb_array", "time_limit": 3}
    vector, single = gym.make_vec(AGENT, num_envs=1, **options), gym.make(AGENT, **options)
    vector.reset(seed=2), single.reset(seed=2)
    for t in range(6):
        vector.step(np.array([3]))
        single.reset() if t == 3 else single.step(3)
        assert np.array_equal(vector.render()[0], single.render())  # type: ignore[index]


@pytest.mark.filterwarnings("ignore")
def test_spec_of_pictures_suits_gymnasium_s_recorder(tmp_path: Any) -> None:
    pytest.importorskip("moviepy")
    vector = gym.make_vec(AGENT, num_envs=4, render_mode="rgb_array", time_limit=3)
    recorder = RecordVideo(vector, str(tmp_path), episode_trigger=lambda episode: episode == 0)
    recorder.reset(seed=0)
    for _ in range(5):
        recorder.step(np.zeros(4, dtype=int))
    recorder.close()
    (clip,) = tmp_path.glob("*.mp4")
    assert clip.stat().st_size > 1000


def test_spec_of_pictures_a_window_is_drawn_at_every_step_and_none_for_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = animarl_envs.parallel_env("agent", render_mode="human")
    shown: list[int] = []
    draw = Renderer.draw
    monkeypatch.setattr(Renderer, "draw", lambda *told: shown.append(1) or draw(*told))
    env.reset(seed=0)
    for _ in range(3):
        env.step(dict.fromkeys(env.agents, 0))
    env.close()
    assert len(shown) == 4
    with pytest.raises(InputError, match="render_mode is 'human': choose 'rgb_array' or None"):
        AnimalVectorEnv("agent", 2, render_mode="human")


def test_spec_of_keys_is_one_that_gymnasium_can_play(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame")
    env = gym.make(AGENT, render_mode="rgb_array", time_limit=3)
    taken: list[int] = []

    def after(_: Any, __: Any, action: int, ___: Any, over: bool, cut: bool, ____: Any) -> None:
        taken.append(action)
        if over or cut:
            pygame.event.post(pygame.event.Event(pygame.QUIT))

    play(env, callback=after, noop=12, fps=1000)
    assert set(taken) == {12}


@pytest.mark.parametrize("magnitudes", [(1.0,), (1.75, 1.0, 0.5)])
def test_spec_of_keys_names_every_direction_once(magnitudes: tuple[float, ...]) -> None:
    moves = {name: {"magnitudes": magnitudes} for name in SPECIES["agent"].individuals}
    env = AnimalEnv("agent", locomotion=moves, demos=None)
    keys = env.get_keys_to_action()
    vectors = env.scenario.species.locomotion[0].action_vectors
    assert sorted(keys.values()) == [*range(12), len(vectors) - 1]
    assert vectors[keys["w"]] == pytest.approx([magnitudes[0], 0.0])
    assert vectors[keys["a"]] == pytest.approx([0.0, magnitudes[0]])
    assert vectors[keys[" "]].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("view", [AnimalEnv, AnimalVectorEnv, AnimalParallelEnv])
def test_spec_of_options_lists_all_of_a_view_and_what_may_be_meant(view: Any) -> None:
    told = refuses("did you mean 'contact_radius': choose", view, "agent", contact_raduis=0.1)
    said = told.partition("choose one of ")[2].split(", ")
    own = {
        name
        for function in (view.__init__, make_scenario)
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY
    }
    wanted = own if view is AnimalParallelEnv else own - {"drivers"}
    assert wanted | {"num_pursuers", "arena", "rebound", "time_limit", "warmup"} <= set(said)
    assert said == sorted(set(said))
    for name in said:
        assert name != "drivers" or view is AnimalParallelEnv


def test_same_step_hands_out_the_last_observation() -> None:
    vector = AnimalVectorEnv("agent", 8, autoreset_mode=AutoresetMode.SAME_STEP)
    waiting = AnimalVectorEnv("agent", 8)
    vector.reset(seed=0)
    waiting.reset(seed=0)
    for _ in range(40):
        actions = np.full(8, 6)
        one, two = vector.step(actions), waiting.step(actions)
        over = one[2] | one[3]
        for b in np.flatnonzero(over):
            assert np.array_equal(one[4]["final_obs"][b], two[0][b])
            assert one[4]["final_info"]["outcome"][b] == two[4]["outcome"][b]
        if over.any():
            return
    raise AssertionError("no episode ended")


def test_disabled_autoreset_wants_a_mask() -> None:
    vector = AnimalVectorEnv("agent", 4, autoreset_mode="Disabled", time_limit=3)
    vector.reset(seed=0)
    for _ in range(3):
        ended = vector.step(np.full(4, 12))
    over = ended[2] | ended[3]
    assert over.all()
    refuses("reset", vector.step, np.full(4, 12))
    vector.reset(options={"reset_mask": over})
    vector.step(np.full(4, 12))


@pytest.mark.parametrize("seed", [9, [9, 10], (9, 10), (None, 4)])
def test_a_seed_does_not_touch_copies_that_run_on(seed: Any) -> None:
    """As in Gymnasium's own vectors."""
    found = []
    for mode in (None, "sync"):
        envs = gym.make_vec("AnimaRL/Newt-v0", 2, vectorization_mode=mode, time_limit=12)
        envs.reset(seed=3)
        envs.step(np.array([1, 1]))
        envs.reset(seed=seed, options={"reset_mask": np.array([True, False])})
        demos = [envs.step(np.array([1, 1]))[4]["demo"].tolist() for _ in range(15)]
        found.append(demos)
    assert found[0] == found[1]


HUGE = 2**200


def make_all() -> list[Any]:
    return [
        gym.make("AnimaRL/Agent-v0"),
        gym.make_vec("AnimaRL/Agent-v0", 3),
        animarl_envs.parallel_env("agent"),
    ]


def first(result: Any) -> Any:
    observation = result[0]
    return np.stack(list(observation.values())) if isinstance(observation, dict) else observation


@pytest.mark.parametrize("env", make_all(), ids=["single", "vector", "parallel"])
def test_seeds_of_any_size_start_streams_of_their_own(env: Any) -> None:
    same = first(env.reset(seed=HUGE)), first(env.reset(seed=HUGE))
    np.testing.assert_array_equal(*same)
    assert not np.array_equal(same[0], first(env.reset(seed=HUGE + 1)))


@pytest.mark.parametrize("env", make_all()[:2], ids=["single", "vector"])
@pytest.mark.parametrize("options", [3, {"demos": 0}, ["demo"]])
def test_options_that_do_not_exist_are_refused_by_name(env: Any, options: Any) -> None:
    refuses("demo", env.reset, options=options)


def test_the_parallel_view_warns_of_unknown_options() -> None:
    """PettingZoo's own tests give one that nobody knows."""
    env = animarl_envs.parallel_env("agent")
    with pytest.warns(UserWarning, match="no option 'demos': it knows demo"):
        env.reset(options={"demos": 0})
    refuses("give a dictionary", env.reset, options=3)


def test_a_copy_without_a_seed_goes_on_with_its_stream() -> None:
    env, other = gym.make_vec("AnimaRL/Agent-v0", 3), gym.make_vec("AnimaRL/Agent-v0", 3)
    env.reset(seed=[1, 5, 2])
    other.reset(seed=[7, 5, 8])
    one, two = env.reset(seed=[1, None, 2])[0], other.reset(seed=[1, None, 2])[0]
    np.testing.assert_array_equal(one, two)  # the middle one goes on from 5 in both
    np.testing.assert_array_equal(one[[0, 2]], other.reset(seed=[1, 9, 2])[0][[0, 2]])
    refuses("2 seeds: give 3", env.reset, seed=[1, 2])


def test_strangers_have_no_spaces() -> None:
    env = animarl_envs.parallel_env("agent")
    for space in (env.observation_space, env.action_space):
        refuses("no individual 'ghost': choose one of predator_0", space, "ghost")


def test_neighbouring_training_seeds_share_no_stream() -> None:
    streams = []
    for seed in range(4):
        env = SlotVecEnv("agent", 16)
        env.seed(seed)
        env.reset()
        streams.append(env.world.random_state.copy())
    assert len(np.unique(np.concatenate(streams))) == 4 * 16


def test_a_second_dtw_reward_is_refused() -> None:
    env = DTWReward(gym.make("AnimaRL/Agent-v0"))
    refuses("already", DTWReward, env)
