"""``animarl watch``: clips of recorded, scripted and trained animals."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
import pytest
from commands import animarl
from recordings import cut_short
from refusals import refuses
from small_runs import few, made

from animarl_algos.cli.watch import play, prepare, trained_actor
from animarl_envs.drawing.render import Renderer
from animarl_envs.worlds.chase.world import ChaseWorld

NEWT, MOTH = "AnimaRL/Newt-v0", "AnimaRL/Silkmoth-v0"


@pytest.fixture(scope="module")
def demos(tmp_path_factory) -> str:
    """A few newt episodes, in a file."""
    return str(few("newt").save(tmp_path_factory.mktemp("demos") / "newts.npz"))


def test_writes_a_clip_and_says_so(tmp_path):
    clip = tmp_path / "moth.gif"
    asked = ("--demos", "none", "--steps", 5, "--out", clip, "--size", 100, "--fps", 5)
    said = animarl("watch", MOTH, *asked)
    shown = [imageio.immeta(clip, index=k)["duration"] for k in range(6)]
    assert shown == [200] * 5 + [1200]  # the start, five steps, and the last one held for a second
    assert imageio.imread(clip).shape[-3:-1] == (112, 100)
    for word in ("Wrote", "2.5 x real time", "stopped after 2.5 s"):
        assert word in said


def test_a_clip_of_a_long_episode_is_its_beginning(tmp_path, monkeypatch):
    monkeypatch.setattr("animarl_algos.cli.watch.CLIP_STEPS", 3)
    monkeypatch.setattr("animarl_algos.cli.watch.GIF_STEPS", 4)
    clip = tmp_path / "moth.gif"
    asked = ("watch", MOTH, "--demos", "none", "--out", clip, "--size", 100)
    assert "the clip shows its first 3; give --steps" in " ".join(animarl(*asked).split())
    assert len(imageio.imread(clip, index=None)) == 4
    refuses("a .gif of 5 steps takes too much memory", animarl, *asked, "--steps", 5)


def test_the_same_seed_gives_the_same_clip_and_another_another(tmp_path):
    clips = []
    for number, seed in enumerate(("3", "3", "4")):
        clip = tmp_path / f"{number}.gif"
        asked = ("--demos", "none", "--steps", 3, "--seed", seed, "--out", clip, "--size", 100)
        animarl("watch", NEWT, *asked)
        clips.append(clip.read_bytes())
    assert clips[0] == clips[1] != clips[2]


def positions_of(world, actor, steps, **more):
    world.seed([0])
    pictures = play(world, actor, Renderer("rgb_array", size=100, fps=1.0), steps=steps, **more)
    return np.stack([world.position[0].copy() for _ in pictures])


def test_recorded_animals_beside_simulated_ones(tmp_path):
    clip = tmp_path / "flies.gif"
    asked = ("--episodes", 2, "--steps", 4, "--size", 100, "--out", clip)
    said = animarl("watch", "--model", "fly", "--beside", *asked)
    assert said.count(", recorded: ") == said.count(", simulated: ") == 2
    assert said.count(", test)") == 4
    first = imageio.imread(clip, index=0)[:100, :, :3]
    assert first.shape[1] == 200
    assert (first[:, :100] == first[:, 100:]).mean() > 0.99  # both begin at the same places
    replayed, _ = prepare(None, model="fly", replayed=True, split="test")
    assert replayed.scenario.drivers == ("replay",) * 3


def test_without_a_model_the_recorded_paths_are_followed(demos):
    world, actor = prepare(NEWT, demos=demos, split="test")
    path = positions_of(world, actor, steps=6)
    starts = [world.demos.episode(i).positions for i in range(len(world.demos))]
    assert len(starts) == len(few("newt").select(split="test"))
    assert any(np.allclose(path[:7], one[:7], atol=1e-12) for one in starts)


def test_a_replayed_recording_ends_at_its_last_frame():
    """The world goes on to its time limit; what it would show has no recording any more."""
    cut = cut_short(few("fly"), 6)
    world, actor = prepare("AnimaRL/Fly-v0", demos=cut, split="test")
    endings: list[str] = []
    path = positions_of(world, actor, steps=None, endings=endings)
    assert len(path) == 6 + 1  # the last picture is held
    shown = world.demos.episode(int(world.demo[0]))
    np.testing.assert_allclose(path[:6], shown.positions, atol=1e-12)
    assert endings == [f"recording ended after {5 * cut.dt:.1f} s ({shown.recording}, test)"]


def test_by_script_males_approach_the_female(demos):
    world, actor = prepare(NEWT, by="script", demos=demos, start="uniform")
    path = positions_of(world, actor, steps=1)
    moved, towards = path[1, :2] - path[0, :2], path[0, 2] - path[0, :2]
    cosine = (moved * towards).sum(-1) / np.linalg.norm(moved, axis=-1)
    np.testing.assert_allclose(cosine, np.linalg.norm(towards, axis=-1))


class Pusher:
    """A policy that always accelerates straight ahead and counts its own calls."""

    def __init__(self, observations: int) -> None:
        self.observation_space = SimpleNamespace(shape=(observations,))
        self.seen: list[tuple[np.ndarray, int | None, np.ndarray]] = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.seen.append((observation.copy(), state, episode_start.copy()))
        return np.zeros(len(observation), dtype=np.int64), (state or 0) + 1


def test_a_trained_run_drives_its_fitted_animals(tmp_path):
    agent = "AnimaRL/Agent-v0"
    run = made(tmp_path, "dqn", demos=few(), rolled_out=False)
    world, actor = prepare(agent, model=run.path)
    assert world.scenario.drivers == ("action",) * 3
    assert world.scenario.species.locomotion == run.fit.locomotion
    assert len(positions_of(world, actor, steps=3)) == 4 + 1  # the last picture is held
    world, _ = prepare(agent, model=run.path, focal="prey")
    assert world.scenario.drivers == ("replay", "replay", "action")
    refuses("AnimaRL/Agent-v0", prepare, NEWT, model=run.path)
    refuses("predator_1", prepare, agent, model=run.path, focal="nobody")
    changed = run.record | {"settings": run.record["settings"] | {"acting": "chosen"}}
    (run.path / "settings.json").write_text(json.dumps(changed))
    refuses("no acting rule was chosen yet", prepare, agent, model=run.path)
    shutil.rmtree(run.path / "policies")
    refuses("no trained policy", prepare, agent, model=run.path)


def test_a_policy_drives_all_individuals_and_keeps_its_state():
    """The condition is told to one that was trained with the flag."""
    scenario = prepare("AnimaRL/Agent-v0", demos=None, condition=1)[0].scenario
    world = ChaseWorld(replace(scenario, drivers=("action",) * 3), 1)
    components = len(world.observation_components)
    for flag in (0, 1):
        policy = Pusher(components + flag)
        positions_of(world, trained_actor(policy), steps=3)
        assert [state for _, state, _ in policy.seen] == [None, 1, 2]
        assert [start.all() for _, _, start in policy.seen] == [True, False, False]
        assert all(seen.shape == (3, components + flag) for seen, _, _ in policy.seen)
        assert not flag or (policy.seen[0][0][:, -1] == 1).all()


def test_a_closed_window_ends_the_show(monkeypatch):
    import pygame

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    world, actor = prepare(NEWT, demos=None)
    window = Renderer("human", size=100, fps=100.0)
    for _ in play(world, actor, window, steps=2):
        pytest.fail("a window yields no pictures")
    steps: list[int] = []
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    list(play(world, actor, window, steps=50, on_step=lambda: steps.append(1)))
    assert window.closed
    assert not steps


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("AnimaRL/Bird-v0",), "Newt-v0"),
        (("CartPole-v1",), "no species"),
        ((NEWT, "--out", "clip.avi"), r"\.gif or \.mp4"),
        ((NEWT, "--focal", "male_0"), "--model"),
        ((NEWT, "--beside", "--out", "a.gif"), "--beside shows a model"),
        ((NEWT, "--demos", "none", "--condition", "1", "--out", "a.gif"), "condition"),
        ((NEWT, "--demos", "nowhere.npz", "--out", "a.gif"), "nowhere.npz"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refuses(message, animarl, "watch", *arguments)
    assert not list(tmp_path.iterdir())


def test_a_variant_registered_by_the_user_is_watched_with_its_options():
    gym.register("Test/Duel-v0", entry_point="animarl_envs.views.single:AnimalEnv",
                 kwargs={"species": "agent", "num_pursuers": 1, "demos": None})  # fmt: skip
    try:
        world, actor = prepare("Test/Duel-v0")
        assert positions_of(world, actor, steps=2).shape[1:] == (2, 2)
    finally:
        del gym.registry["Test/Duel-v0"]
