"""The plume: what a table says, the filament model, a user's movie, and the fit to recordings."""

import math
import pickle
import re
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refuses

import animarl_envs  # noqa: F401  registers the environments
from animarl_envs.drawing.render import write_clip
from animarl_envs.errors import InputError
from animarl_envs.worlds.plume.filaments import FilamentModel
from animarl_envs.worlds.plume.plume import ModelPlume, Plume, as_plume, hit_table, is_hit
from tools.packaged_data.plume_fit import compare

SMALL = replace(FilamentModel.fitted(), period=6.0)
MOVIE = {"mm_per_pixel": 1.0, "source_pixel": (10, 0), "frame_rate": 30.0}


def concentration(model: FilamentModel, pattern: int, time: float, x: float, y: float) -> float:
    """The equations of the model, summed over all filaments one by one."""
    total = 0.0
    for s, U, v, w, y0, z0 in model.release(pattern).reshape(-1, 6):
        age = (time - s) % model.period
        square = model.initial_radius**2 + model.growth * age
        dx, dy, z = x - U * age, y - y0 - v * age, z0 + w * age
        if max(abs(dx), abs(dy), abs(z)) <= 3 * math.sqrt(square):
            strength = (model.initial_radius**2 / square) ** 1.5
            total += strength * math.exp(-(dx**2 + dy**2 + z**2) / (2 * square))
    return total


def test_concentration_is_the_sum_over_filaments() -> None:
    rng = np.random.default_rng(0)
    _, _, x0, y0 = SMALL.grid
    seen = 0
    for time in (0.3, 1.7, 5.9):
        field = SMALL.concentration(1, time)
        lit = np.argwhere(field > 1e-3)
        for row, column in rng.permutation(lit)[:25]:
            x, y = x0 + column * SMALL.cell, y0 + row * SMALL.cell
            expected = concentration(SMALL, 1, time, x, y)
            assert field[row, column] == pytest.approx(expected, rel=1e-4)
            seen += 1
    assert seen > 30


def test_table_is_the_maximum_over_a_step_and_over_the_antenna() -> None:
    table = ModelPlume(SMALL).pattern_table(0, 0.5, 0.0025)
    assert table.bits.shape[:2] == (1, 12)
    for step in (0, 7):
        frames = [SMALL.concentration(0, f / 30.0) for f in range(15 * step, 15 * step + 15)]
        hit = np.max(frames, axis=0) > SMALL.threshold
        near = hit.copy()  # 2.5 mm is one cell: the four neighbours
        near[1:] |= hit[:-1]
        near[:-1] |= hit[1:]
        near[:, 1:] |= hit[:, :-1]
        near[:, :-1] |= hit[:, 1:]
        assert hit.any()
        np.testing.assert_array_equal(table.unpack(0, step), near)


def test_puffs_come_once_a_second_and_travel_downwind() -> None:
    """Seen at one place the odour peaks every second; farther downwind it peaks later."""
    plume = ModelPlume(replace(FilamentModel.fitted(), period=60.0))
    table = plume.pattern_table(0, 1 / 30, 0.0025)

    def rhythm(x: float) -> complex:
        column = table.source_column + round(x / table.cell)
        rows = slice(table.source_row - 8, table.source_row + 9)
        share = np.array([table.unpack(0, f)[rows, column].mean() for f in range(1800)])
        return complex((share * np.exp(-2j * np.pi * np.arange(1800) / 30)).sum() / share.sum())

    near, far = rhythm(0.06), rhythm(0.2)
    assert abs(near) > 0.6
    delay = -np.angle(far / near) / (2 * np.pi)  # [s]
    assert 0.14 / delay == pytest.approx(plume.model.advection_speed, rel=0.35)


def test_movie_steps_unite_their_frames() -> None:
    frames = np.zeros((7, 21, 40))
    frames[np.arange(7), 10, np.arange(7)] = 200.0  # one pixel per frame, moving downwind
    plume = Plume.from_array(frames, mm_per_pixel=1.0, source_pixel=(10, 0), frame_rate=6.0)
    table = plume.pattern_table(0, 0.5, 0.0)
    hits = [np.flatnonzero(table.unpack(0, s)[table.source_row]).tolist() for s in range(2)]
    assert table.bits.shape[1] == 2  # whole steps of three frames; the seventh is left over
    assert hits == [[0, 1, 2], [3, 4, 5]]
    slow = replace(plume, frame_rate=1.0).pattern_table(0, 0.5, 0.0)
    assert slow.bits.shape[1] == 14  # a frame that lasts two steps is seen twice
    assert np.array_equal(slow.unpack(0, 4), slow.unpack(0, 5))


def test_antenna_reaches_beyond_the_picture() -> None:
    frames = np.ones((1, 3, 3), dtype=bool)
    movie = {"mm_per_pixel": 1, "source_pixel": (1, 1), "frame_rate": 1}
    table = Plume.from_array(frames, **movie).pattern_table(0, 0.5, 0.002)
    assert table.extent == pytest.approx((-0.0035, 0.0035, -0.0035, 0.0035))
    assert table.unpack(0, 0).sum() == 9 + 4 * 3 * 2 + 4  # edges two cells wide, corners one cell


def test_movie_file_is_read_when_needed(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).random((6, 21, 12)) > 0.7
    np.save(tmp_path / "plume.npy", frames)
    from_file = Plume.from_movie(tmp_path / "plume.npy", **MOVIE, threshold=0.5)
    in_memory = Plume.from_array(frames, **MOVIE)
    tables = [p.pattern_table(0, 0.1, 0.001).bits for p in (from_file, in_memory)]
    np.testing.assert_array_equal(*tables)


def drifting_blobs() -> NDArray[np.uint8]:
    """``(12, 48, 64)``: squares of eight pixels drifting to the right, in grey."""
    frames = np.zeros((12, 48, 64), dtype=np.uint8)
    for f, frame in enumerate(frames):
        for row, column in ((8, 4), (24, 20), (32, 36)):
            frame[row : row + 8, (column + 2 * f) % 56 : (column + 2 * f) % 56 + 8] = 230
    return frames


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_movie_in_a_video_file_is_the_array_it_was_made_of(tmp_path: Path, suffix: str) -> None:
    frames = drifting_blobs()
    path = tmp_path / f"plume{suffix}"
    colours = np.repeat(frames[..., None], 3, axis=-1)
    if suffix == ".mp4":
        lossless = {"codec": "libx264rgb", "pixelformat": "rgb24", "output_params": ["-crf", "0"]}
        imageio.imwrite(path, colours, fps=30, macro_block_size=1, **lossless)
    else:
        imageio.imwrite(path, colours, duration=1000 / 30)
    given = {"mm_per_pixel": 1.0, "source_pixel": (24, 0), "frame_rate": 30.0}
    from_file = Plume.from_movie(path, **given)
    in_memory = Plume.from_array(frames, **given)
    for dt in (0.1, 0.2):
        tables = [p.pattern_table(0, dt, 0.0025) for p in (from_file, in_memory)]
        assert tables[0][1:] == tables[1][1:]
        np.testing.assert_array_equal(tables[0].bits, tables[1].bits)
    assert tables[0].unpack(0, 0).any()


def test_a_lossy_movie_gives_nearly_the_same_hits_and_a_moth_smells_it(tmp_path: Path) -> None:
    """Written by the project's own clip writer, as anybody's camera would: H.264, 4:2:0."""
    frames = drifting_blobs()
    colours = np.repeat(frames[..., None], 3, axis=-1)
    path = write_clip(list(colours), tmp_path / "plume.mp4", fps=30.0)
    given = {"mm_per_pixel": 5.0, "source_pixel": (24, 0), "frame_rate": 4.0}
    plume = Plume.from_movie(path, **given)
    found = plume.pattern_table(0, 0.5, 0.0)
    exact = Plume.from_array(frames, **given).pattern_table(0, 0.5, 0.0)
    same = [found.unpack(0, s) == exact.unpack(0, s) for s in range(6)]
    assert np.mean(same) > 0.98
    env = gym.make("AnimaRL/Silkmoth-v0", plume=plume, demos=None, observation="compact")
    env.reset(seed=0)
    signals = np.stack([env.step(0)[0][3:5] for _ in range(10)])
    assert (signals == 1.0).any()
    said = env.reset(seed=0)[1]["scenario"]["plume"]
    assert (said["kind"], said["path"], said["frame_rate"]) == ("MoviePlume", str(path), 4.0)


@pytest.mark.parametrize("content", [b"", b"no movie at all" * 50, "cut"])
def test_a_damaged_video_is_refused(tmp_path: Path, content: bytes | str) -> None:
    path = tmp_path / "plume.mp4"
    if content == "cut":
        colours = np.repeat(drifting_blobs()[..., None], 3, axis=-1)
        write_clip(list(colours), path, fps=30.0)
        content = path.read_bytes()[:300]
    assert isinstance(content, bytes)
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"plume\.mp4: it cannot be read"):
        gym.make("AnimaRL/Silkmoth-v0", plume=Plume.from_movie(path, **MOVIE))


@pytest.mark.parametrize(
    ("frames", "options", "says"),
    [
        (np.zeros(4), {}, "(4,)"),
        (np.zeros((4, 4)), {}, "(4, 4)"),
        (np.zeros((2, 4, 4, 3)), {}, "(frames, height, width)"),
        (np.zeros((0, 4, 4)), {}, "(0, 4, 4)"),
        (np.full((1, 4, 4), np.nan), {}, "NaN"),
        (np.array([[["a"]]]), {}, "grey values"),
        (np.zeros((1, 4, 4)), {"mm_per_pixel": 0.0}, "mm_per_pixel"),
        (np.zeros((1, 4, 4)), {"frame_rate": -30.0}, "frame_rate"),
        (np.zeros((1, 4, 4)), {"source_pixel": (1.5, 0)}, "source_pixel"),
        (np.zeros((1, 4, 4)), {"source_pixel": (1, 2, 3)}, "source_pixel"),
        (np.zeros((1, 4, 4)), {"threshold": math.nan}, "threshold"),
    ],
)
def test_bad_movie_is_refused_in_one_sentence(
    frames: np.ndarray, options: dict[str, object], says: str
) -> None:
    refuses(re.escape(says), Plume.from_array, frames, **(MOVIE | options))


def test_bad_choices_are_refused(tmp_path: Path) -> None:
    refuses("no such file", Plume.from_movie, tmp_path / "absent.mp4", **MOVIE)
    np.save(tmp_path / "flat.npy", np.zeros((4, 4)))
    with pytest.raises(InputError, match=r"flat\.npy has shape \(4, 4\)"):
        Plume.from_movie(tmp_path / "flat.npy", **MOVIE).pattern_table(0, 0.5, 0.0)
    refuses("'model', 'off', 'continuous'", as_plume, "windy")
    with pytest.raises(InputError, match="pattern 5 does not exist: choose 0 to 4"):
        hit_table(ModelPlume.fitted(), (5,), 0.5, 0.0025)
    refuses("growth is -1", replace, SMALL, growth=-1.0)
    refuses("whole number", replace, SMALL, period=6.5)


def test_plumes_can_be_pickled_and_tables_are_shared() -> None:
    plume = ModelPlume(SMALL)
    twin = pickle.loads(pickle.dumps(plume))
    assert twin == plume
    assert hit_table(plume, (0, 1), 0.5, 0.0025) is hit_table(twin, (0, 1), 0.5, 0.0025)


@pytest.mark.realdata
def test_fitted_model_agrees_with_recorded_plumes(data_dir: Path) -> None:
    folder = data_dir / "silkmoth_mothvr"
    seen = compare(folder, draws=3)
    correlation, cells = seen["correlation over cells"]
    assert cells > 2000
    assert correlation > 0.7
    assert correlation > seen["correlation of recorded halves"][0]
    assert seen["hit rate"]["model"] == pytest.approx(seen["hit rate"]["recorded"], rel=0.15)
    for _, recorded, modelled in seen["by distance"][:-1]:
        assert modelled == pytest.approx(recorded, rel=0.4)
    blank = {who: np.median(lengths) for who, lengths in seen["blank lengths"].items()}
    assert blank["model"] == pytest.approx(blank["recorded"], abs=4)  # one puff a second


def test_patterns_are_fixed_different_and_repeat() -> None:
    assert np.array_equal(SMALL.release(2), SMALL.release(2))
    assert not np.array_equal(SMALL.release(2), SMALL.release(3))
    again = SMALL.concentration(0, 1.2 + SMALL.period)
    np.testing.assert_allclose(again, SMALL.concentration(0, 1.2), atol=1e-5)


def test_is_hit_looks_up_the_nearest_cell() -> None:
    frames = np.zeros((1, 21, 40), dtype=bool)
    frames[0, 4, 25] = True  # 6 rows above the source, 25 columns downwind
    table = Plume.from_array(frames, **MOVIE).pattern_table(0, 0.5, 0.0)

    def hit(x: float, y: float) -> bool:
        return bool(is_hit(table, 0, 0, x, y))

    assert hit(0.025, 0.006) and hit(0.0254, 0.0056)
    assert not hit(0.025, -0.006) and not hit(0.026, 0.006) and not hit(5.0, 0.006)
