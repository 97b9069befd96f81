"""Clips, environments that draw on, and the scenes recorded of a world."""

import pickle
from copy import deepcopy
from pathlib import Path

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
import pytest
from refusals import refuses

from animarl_envs import parallel_env
from animarl_envs.drawing.render import write_clip
from animarl_envs.drawing.scene import SceneRecorder
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds.chase.world import ChaseWorld


def frames(count: int = 4):
    for k in range(count):
        frame = np.zeros((64, 64, 3), dtype=np.uint8)
        frame[:, : 16 * (k + 1)] = (0, 114, 178)
        yield frame


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_clip_holds_all_frames_at_the_wanted_speed(tmp_path, suffix):
    path = write_clip(frames(), tmp_path / f"clip{suffix}", fps=5)
    assert list(tmp_path.iterdir()) == [path]
    back = np.stack([np.asarray(f)[..., :3] for f in imageio.imiter(path)])
    assert back.shape == (4, 64, 64, 3)
    for k, frame in enumerate(frames()):
        assert np.abs(back[k].astype(int) - frame).mean() < 6
    if suffix == ".gif":
        assert imageio.immeta(path)["duration"] == 200
    else:
        assert imageio.immeta(path)["fps"] == 5


def test_other_suffixes_are_refused(tmp_path):
    refuses(r"\.gif or \.mp4", write_clip, frames(), tmp_path / "clip.avi")
    assert not list(tmp_path.iterdir())


def test_an_interrupted_clip_leaves_the_old_file(tmp_path: Path):
    def breaking():
        yield from frames(2)
        raise RuntimeError("stopped")

    path = tmp_path / "clip.gif"
    path.write_bytes(b"old")
    with pytest.raises(RuntimeError, match="stopped"):
        write_clip(breaking(), path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_clip_of_nothing_is_refused(tmp_path):
    refuses("no frame", write_clip, iter(()), tmp_path / "clip.gif")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("species", ["Agent", "Silkmoth"])
@pytest.mark.parametrize("twin_of", [deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_in_mid_episode_draws_on_alike(species, twin_of):
    env = gym.make(f"AnimaRL/{species}-v0", render_mode="rgb_array").unwrapped
    env.reset(seed=2)
    env.step(3)
    env.render()
    twin = twin_of(env)
    for action in (0, 5, 12):
        env.step(action)
        twin.step(action)
    picture = env.render()
    assert picture.shape[2] == 3
    np.testing.assert_array_equal(picture, twin.render())
    env.close()
    twin.close()


def test_all_individuals_are_drawn_and_nothing_before_the_first_episode():
    everybody = parallel_env("fly", render_mode="rgb_array")
    refuses("reset", everybody.render)
    everybody.reset(seed=0)
    assert everybody.render().shape == (672, 600, 3)
    everybody.close()


# -- scenes of a world --------------------------------------------------


def test_recorder_follows_a_world():
    world = ChaseWorld(make_scenario("agent", demos=None), num_copies=2)
    world.seed(np.array([3, 4]))
    world.reset()
    recorder = SceneRecorder(world, copy=1)
    recorder.start()
    rng = np.random.default_rng(0)
    path, total = [world.position[1].copy()], np.zeros(3)
    for _ in range(6):
        world.step(rng.integers(0, 12, size=(2, 3)))
        recorder.follow()
        path.append(world.position[1].copy())
        total += world.reward[1]
    scene = recorder.scene()
    np.testing.assert_array_equal(scene.trails, path)
    np.testing.assert_allclose(scene.rewards, total)
    velocity = world.velocity[1]
    np.testing.assert_allclose(scene.headings, np.arctan2(velocity[:, 1], velocity[:, 0]))
    assert scene.step == 6
    recorder.start()
    assert len(recorder.scene().trails) == 1
    world.step(np.full((2, 3), 12))
    assert len(scene.trails) == 7  # a scene is not changed by what follows


def test_recorder_says_who_touched_whom():
    start = np.array([(0.0, 0.0), (0.8, 0.8), (0.12, 0.0)])
    world = ChaseWorld(make_scenario("agent", demos=None, start=start), num_copies=1)
    world.reset()
    recorder = SceneRecorder(world)
    recorder.start()
    while not world.terminated[0]:
        world.step(np.array([[0, 12, 12]]))
        recorder.follow()
    scene = recorder.scene()
    assert scene.touched.tolist() == [True, False, True]
    assert scene.note == "predator_0 reached prey"
