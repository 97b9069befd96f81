"""Pictures: right places, right colours, same pixels; windows, clips, scenes of a world."""

import dataclasses
import pickle
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
import pytest
from recordings import search
from refusals import refuses

from animarl_envs import parallel_env
from animarl_envs.demos.summary import Unit
from animarl_envs.drawing import palette
from animarl_envs.drawing.palette import BODIES
from animarl_envs.drawing.render import Renderer, round_length, window_of, write_clip
from animarl_envs.drawing.scene import PlumeField, Scene, SceneRecorder
from animarl_envs.errors import MissingExtraError
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT, SILKMOTH, SPECIES
from animarl_envs.species.base import BODIES as SPECIES_BODIES
from animarl_envs.species.base import PLAIN_BODY, body_of_each
from animarl_envs.species.options import with_options
from animarl_envs.worlds import make_world
from animarl_envs.worlds.chase.world import ChaseWorld

SIZE = 200
HUNT = with_options(AGENT, num_pursuers=1, bodies=PLAIN_BODY)
LATER = {
    "step": 3, "rewards": np.ones(2), "note": "time limit", "condition": "condition 1: shared",
}  # fmt: skip


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer("rgb_array", size=SIZE)


def make_scene(**changes: Any) -> Scene:
    scene = Scene(
        species=HUNT, positions=np.array([(0.5, 0.4), (-0.5, -0.6)]), headings=np.array([0.7, 2.0]),
        trails=np.zeros((0, 2, 2)), rewards=np.zeros(2),
    )  # fmt: skip
    return dataclasses.replace(scene, **changes)


def make_search(path: np.ndarray, **changes: Any) -> Scene:
    """A moth at the end of its path ``(t, 2)``."""
    return Scene(
        species=SILKMOTH, positions=path[-1:], headings=np.array([3.0]), trails=path[:, None],
        rewards=np.zeros(1), **changes,
    )  # fmt: skip


def pixel_of(scene: Scene, point: tuple[float, float]) -> tuple[int, int]:
    """Row and column of a point of the arena frame."""
    view = window_of(scene)
    column = (point[0] - view.x + view.half) / (2 * view.half) * SIZE
    row = (view.y + view.half - point[1]) / (2 * view.half) * SIZE
    return int(row), int(column)


def colour_distance(pixel: np.ndarray, colour: palette.RGB) -> int:
    return int(np.abs(pixel.astype(int) - colour).max())


def darkness(picture: np.ndarray, place: tuple[int, int]) -> int:
    """The darkest of the pixels around a place, as 255 minus its mean."""
    row, column = place
    patch = picture[row - 1 : row + 2, column - 1 : column + 2].astype(int)
    return int(255 - patch.mean(axis=-1).min())


def test_picture_is_an_array_and_the_same_scene_gives_the_same_pixels(renderer):
    first, second = renderer.draw(make_scene()), Renderer("rgb_array", size=SIZE).draw(make_scene())
    assert first.shape == (renderer.height, SIZE, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    np.testing.assert_array_equal(first, second)


def test_individuals_are_where_they_are_with_y_up(renderer):
    scene = make_scene()
    picture = renderer.draw(scene)
    assert colour_distance(picture[pixel_of(scene, (0.5, 0.4))], palette.PURSUERS[0]) < 12
    assert colour_distance(picture[pixel_of(scene, (-0.5, -0.6))], palette.TARGET) < 12
    assert colour_distance(picture[pixel_of(scene, (0.0, 0.0))], palette.ARENA) == 0


@pytest.mark.parametrize("shape", ["square", "disc"])
def test_mirrored_scene_is_the_mirrored_picture(renderer, shape):
    trails = np.linspace((-0.8, -0.2), (0.5, 0.4), 20)[:, None].repeat(2, axis=1)
    scene = make_scene(species=with_options(HUNT, arena=shape), trails=trails)
    flip = np.array([-1.0, 1.0])
    mirrored = dataclasses.replace(
        scene, positions=scene.positions * flip, trails=trails * flip,
        headings=np.pi - scene.headings,
    )  # fmt: skip
    unturned = dataclasses.replace(mirrored, headings=scene.headings)

    def difference(other: Scene) -> float:
        row, column = pixel_of(scene, (0.5, 0.4))
        near = np.s_[row - 15 : row + 15, column - 15 : column + 15]
        field, mirror = renderer.draw(scene)[:SIZE], renderer.draw(other)[:SIZE, ::-1]
        return float(np.abs(field[near].astype(int) - mirror[near]).mean())

    assert difference(mirrored) < 0.5 * difference(unturned)


def test_trail_fades_with_age(renderer):
    trails = np.zeros((101, 2, 2))
    trails[:, 0] = np.linspace((-0.9, 0.4), (0.5, 0.4), 101)
    trails[:, 1] = (-0.5, -0.6)
    scene = make_scene(trails=trails)
    picture = renderer.draw(scene)
    ages = [darkness(picture, pixel_of(scene, (x, 0.4))) for x in (-0.8, 0.0, 0.38)]
    floor = 255 - np.mean(palette.ARENA)
    assert floor + 5 < ages[0] < ages[1] < ages[2]


def test_touched_target_is_highlighted(renderer):
    scene = make_scene(positions=np.array([(-0.39, -0.6), (-0.5, -0.6)]))
    touched = make_scene(positions=np.array([(-0.41, -0.6), (-0.5, -0.6)]))
    assert (scene.touched.tolist(), touched.touched.tolist()) == ([False] * 2, [True] * 2)
    beside = pixel_of(scene, (-0.5, -0.525))
    before, after = (renderer.draw(each)[beside] for each in (scene, touched))
    assert colour_distance(after, palette.TOUCH) < colour_distance(before, palette.TOUCH)
    assert after[2] < before[2] - 60  # from grey to amber


def test_plume_has_its_first_row_at_the_bottom_and_fades_out_before_its_field_ends(renderer):
    values = np.zeros((10, 10))
    values[1, 1] = 1.0
    plume = PlumeField(values=values, extent=(-1.0, 1.0, -1.0, 1.0))
    scene = make_scene(plume=plume)
    picture = renderer.draw(scene)
    hot, cold = pixel_of(scene, (-0.7, -0.7)), pixel_of(scene, (-0.7, 0.7))
    assert colour_distance(picture[cold], palette.ARENA) == 0
    assert colour_distance(picture[hot], palette.ARENA) > 40
    plume = PlumeField(values=np.ones((50, 50)), extent=(-0.9, 0.9, -0.9, 0.9))
    scene = make_scene(plume=plume)
    picture = renderer.draw(scene)

    def odour(x: float, y: float) -> int:
        return colour_distance(picture[pixel_of(scene, (x, y))], palette.ARENA)

    assert odour(0.0, 0.0) == odour(-0.75, 0.0) > 60  # it begins at once
    for x, y in ((-0.895, 0.2), (0.86, 0.2), (0.0, 0.86), (0.0, -0.86)):
        assert odour(x, y) < 5


@pytest.mark.parametrize("away", [(3.0, 0.0), (-0.4, -1.7), (0.9, 0.9)])
def test_a_long_search_stays_in_the_picture_and_fills_it(away):
    path = np.linspace((0.3, 0.0), away, 500)
    moth = make_search(path)
    view = window_of(moth)
    everything = np.concatenate([path, np.zeros((1, 2))])
    assert (np.abs(everything - (view.x, view.y)) < view.half).all()
    assert np.ptp(everything, axis=0).max() > 0.5 * view.half  # of the 2 that are shown
    assert window_of(make_search(np.concatenate([path, path[-1:] + 0.001]))) == view
    far = make_scene(positions=np.array([(2.5, 0.0), (0.0, 0.0)]))
    assert window_of(make_scene()).half < 1.3 and window_of(far).half > 2.5


def test_every_body_that_a_species_may_have_is_drawn(renderer):
    assert set(BODIES) == set(SPECIES_BODIES)
    looks = [with_options(HUNT, bodies=(name, "prey")) for name in BODIES]
    pictures = [renderer.draw(make_scene(species=species)) for species in looks]
    for i, picture in enumerate(pictures):
        for other in pictures[:i]:
            assert (picture != other).sum() > 60
    for body in BODIES.values():
        assert max(np.abs(part.outline).max() for part in body) < 1.0


def test_a_species_says_what_its_animals_look_like():
    assert body_of_each(AGENT.bodies, AGENT.roles) == ("predator", "predator", "prey")
    assert body_of_each(SPECIES["newt"].bodies, AGENT.roles) == ("newt",) * 3
    assert SPECIES_BODIES[0] == PLAIN_BODY
    refuses("bodies is 'cat': give one of animal, predator", with_options, AGENT, bodies="cat")


def test_open_field_shows_source_start_and_scale(renderer):
    antennae = np.array([(0.24, 0.015), (0.24, 0.025)])
    moth = make_search(np.array([(0.3, 0.0), (0.25, 0.02)]), antennae=antennae, odour=(1.0, 0.0))
    view = window_of(moth)
    for x in (0.0, 0.3):
        assert abs(x - view.x) < view.half
    wind = renderer.draw(moth)[int(0.9 * SIZE) : SIZE, SIZE // 2 :]
    assert (wind != palette.ARENA).any(axis=-1).sum() > 30
    smelling = dataclasses.replace(moth, odour=(0.0, 0.0))
    assert (renderer.draw(moth) != renderer.draw(smelling)).any()


@pytest.mark.parametrize(
    ("longest", "unit", "length", "label"),
    [
        (0.123, "m", 0.1, "10 cm"), (0.2, "m", 0.2, "20 cm"), (0.0049, "m", 0.002, "2 mm"),
        (7.0, "m", 5.0, "5 m"), (0.7, "unit", 0.5, "0.5 unit"),
    ],
)  # fmt: skip
def test_scale_bar_is_round(longest, unit, length, label):
    found, text = round_length(longest, unit)
    assert found == pytest.approx(length)
    assert text == label


def test_scale_bar_has_the_unit_of_the_recordings(renderer):
    """An arena of half a metre: a bar of 10 cm, as long as one of 0.2 units."""
    told = make_scene(unit=Unit("cm", 50.0))
    drawn = (renderer.draw(told) != renderer.draw(make_scene()))[:SIZE]
    assert drawn.any() and not drawn[: SIZE // 2].any()


def test_scale_bar_of_a_search_follows_the_length_of_its_arena_unit():
    scenario = make_scenario("silkmoth", demos=None, metres_per_unit=0.01)
    assert SceneRecorder(make_world(scenario)).unit == Unit("m", 0.01)
    demos = search()
    scales = {name: {"unit": 1000.0} for name in demos.recording.tolist()}
    told = dataclasses.replace(
        demos, provenance={**demos.provenance, "unit": "mm", "scales": scales}
    )
    assert SceneRecorder(make_world(make_scenario("custom", demos=told))).unit == Unit("mm", 1000.0)
    assert SceneRecorder(make_world(make_scenario("custom", demos=demos))).unit == Unit("m", 1.0)


@pytest.mark.parametrize("what", LATER)
def test_text_strip_tells_time_rewards_condition_and_ending(renderer, what):
    plain, other = renderer.draw(make_scene()), renderer.draw(make_scene(**{what: LATER[what]}))
    np.testing.assert_array_equal(plain[:SIZE], other[:SIZE])
    assert (plain[SIZE:] != other[SIZE:]).any()


def test_many_individuals_fit_the_strip(renderer):
    names = [f"a_rather_long_name_{i}" for i in range(12)]
    crowd = make_scene(
        species=with_options(HUNT, individuals=names),
        positions=np.linspace((-0.9, -0.9), (0.9, 0.9), 12), headings=np.zeros(12),
        trails=np.zeros((0, 12, 2)), rewards=np.zeros(12),
    )  # fmt: skip
    picture = renderer.draw(crowd)
    margin = round(0.02 * SIZE)
    assert colour_distance(picture[SIZE:, -margin:].min(axis=(0, 1)), palette.BACKGROUND) == 0


@pytest.mark.parametrize("arguments", [("svg",), ("rgb_array", 50), ("rgb_array", 600, 0.0)])
def test_renderer_refuses_bad_values(arguments):
    refuses("", Renderer, *arguments)


def test_window_shows_closes_and_stays_closed(monkeypatch):
    import pygame

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window = Renderer("human", size=SIZE, fps=1000.0)
    assert window.draw(make_scene()) is None
    assert pygame.display.get_surface().get_size() == (SIZE, window.height)
    assert not window.closed
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    window.draw(make_scene())
    assert window.closed
    assert not pygame.display.get_init()
    assert window.draw(make_scene()) is None
    window.close()
    window.close()


def test_window_without_display_is_refused_and_missing_pygame_named(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no-such-driver")
    refuses("rgb_array", Renderer("human", size=SIZE).draw, make_scene())
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(MissingExtraError, match=r"animarl\[render\]"):
        Renderer("rgb_array")


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


def test_a_clip_of_nothing_or_of_another_suffix_is_refused(tmp_path):
    refuses(r"\.gif or \.mp4", write_clip, frames(), tmp_path / "clip.avi")
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
