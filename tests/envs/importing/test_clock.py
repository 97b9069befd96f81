"""One clock: the rate that times and frame numbers give, what is asked, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.errors import InputError
from animarl_envs.importing.clock import fit_clock
from animarl_envs.importing.readers import read_tracks
from animarl_envs.importing.tracks import RATE_FROM

FRAMES = np.arange(600)
ONE = np.zeros(len(FRAMES), dtype=np.int64)
PATH = Path("t.csv")


def place(row: int) -> str:
    return f"row {row}"


@pytest.mark.parametrize("rate", [12.5, 25.0, 29.97, 60.0])
@pytest.mark.parametrize("digits", [0, 1, 3])
@pytest.mark.parametrize("cut", [np.floor, np.round])
def test_clock_of_rounded_times_beside_frames(rate: float, digits: int, cut: np.ufunc) -> None:
    times = cut(FRAMES / rate * 10**digits) / 10**digits
    found = fit_clock(PATH, times, ONE, place, FRAMES)
    precise = 1e-9 if rate.is_integer() else 2 * 10.0**-digits / (len(FRAMES) / rate)
    assert found.rate == pytest.approx(rate, rel=precise)


@pytest.mark.parametrize("period", [2.0, 60.0, 3600.0, 14400.0, 86400.0])
@pytest.mark.parametrize("numbered", [False, True])
def test_clock_keeps_slow_periods(period: float, numbered: bool) -> None:
    found = fit_clock(PATH, FRAMES * period, ONE, place, FRAMES if numbered else None)
    assert 1 / found.rate == pytest.approx(period, rel=1e-12)
    np.testing.assert_array_equal(found.frames, FRAMES)
    assert found.residual <= 1e-6


def test_clock_passes_a_pause_of_the_camera() -> None:
    times = FRAMES / 30 + 100.0 * (FRAMES > 300)
    assert fit_clock(PATH, times, ONE, place, FRAMES).rate == pytest.approx(30)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (np.where(FRAMES == 100, 0.0, FRAMES / 30), "row 100 is earlier than that of the frame"),
        (np.cumsum(np.random.default_rng(0).exponential(0.1, 600)), "do not keep step"),
        (np.where(FRAMES == 7, np.nan, FRAMES / 30), "row 7 has no time"),
    ],
)
def test_clock_refuses_times_that_do_not_fit_their_frames(times, words) -> None:
    refuses(words, fit_clock, PATH, times, ONE, place, FRAMES)


@pytest.mark.parametrize(
    ("header", "step", "rate"),
    [
        ("time", 0.04, 25.0), ("time", 40, "time_unit=ms (25 frames/s)"),
        ("time", 1, "frame=time"), ("time", 1 / 1500, "time_unit=min (25 frames/s)"),
        ("time", 1 / 500, 500.0), ("time", 1 / 540, "time_unit=min (9 frames/s)"),
        ("seconds", 2, 0.5), ("time_s", 1, 1.0), ("time (min)", 1, 1 / 60), ("t [ms]", 4, 250.0),
    ],
)  # fmt: skip
def test_clock_asks_for_a_unit_that_no_camera_would_have(header, step, rate, tmp_path) -> None:
    path = tmp_path / "t.csv"
    rows = "".join(f"{n * step:.9f},a,{n / 7:.3f},{n / 9:.3f}\n" for n in range(40))
    path.write_text(f"{header},id,x,y\n{rows}")
    if isinstance(rate, float):
        (tracks,) = read_tracks(path)
        assert tracks.frame_rate == pytest.approx(rate)
        assert tracks.provenance[RATE_FROM].startswith("the column ")
        return
    with pytest.raises(InputError) as caught:
        read_tracks(path)
    assert rate in str(caught.value) and "no unit is stated" in str(caught.value)
    option = rate.partition(" ")[0].split("=")
    assert len(read_tracks(path, **dict([option]))[0]) == 40
