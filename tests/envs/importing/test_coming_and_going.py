"""Animals that come and go, packed tables and clocks that tick unevenly."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from animarl_envs.errors import InputError
from animarl_envs.importing.readers import default_recipe, follow, get_reader, read_tracks

HZ = 12.5


def larvae(folder: Path, name: str, *, uneven: float, count: int = 6) -> Path:
    """Write larvae that crawl straight at 1 mm/s, one after the other, in one packed table."""
    rng, lines = np.random.default_rng(0), ["larva,time_s,x_mm,y_mm"]
    for larva in range(count):
        when = 20.0 * larva + 0.24 + np.arange(250) / HZ
        when += rng.uniform(-uneven, uneven, len(when)) / HZ
        lines += [f"{larva},{t:.4f},{10 + t - 20.0 * larva:.4f},{larva + 1}" for t in when]
    path = folder / f"{name}.csv.gz"
    path.write_bytes(gzip.compress("\n".join(lines).encode() + b"\n"))
    return path


def test_each_animal_that_comes_and_goes_is_a_recording(tmp_path: Path) -> None:
    files = [larvae(tmp_path, name, uneven=0.4) for name in ("fed", "deprived")]
    pattern = "(?P<condition>fed|deprived)"
    demos = follow(default_recipe(get_reader("long-table"), name_pattern=pattern), files)
    assert len(demos) == 12 and demos.individuals == ("individual_0",)
    assert sorted(set(demos.recording.tolist()))[:2] == ["deprived/0", "deprived/1"]
    fed = np.char.startswith(demos.recording.astype(str), "fed/")
    assert len(set(demos.condition[fed])) == len(set(demos.condition[~fed])) == 1
    assert demos.dt == pytest.approx(1 / HZ) and demos.lengths.min() > 240
    # On the even clock the larvae crawl as they did: 1 mm/s, to the rounding of the file.
    (tracks,) = read_tracks(files[0])
    x = tracks.positions[:, 0, 0, 0]
    x = x[np.isfinite(x)]
    assert np.diff(x) * HZ == pytest.approx(1.0, abs=0.01)
    assert "irregular clock resampled to 12.5 Hz" in str(tracks.provenance["read_as"])


def test_an_even_clock_is_taken_as_it_is(tmp_path: Path) -> None:
    (tracks,) = read_tracks(larvae(tmp_path, "fed", uneven=0.0))
    assert tracks.frame_rate == HZ and "resampled" not in str(tracks.provenance["read_as"])


def test_animals_that_are_seen_together_stay_one_recording(tmp_path: Path) -> None:
    rows = [f"{who},{f},{who + f / 10},{f % 7}" for f in range(100) for who in range(3)]
    path = tmp_path / "shoal.csv"
    path.write_text("\n".join(["id,frame,x,y", *rows]) + "\n")
    demos = follow(default_recipe(get_reader("long-table"), frame_rate=10.0), [path])
    assert demos.num_individuals == 3


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"no gzip", "cannot be unpacked"),
        (gzip.compress(b"frame,id,x,y\n" + b"0,a,1,1\n" * 50)[:40], "cannot be unpacked"),
        (gzip.compress(b"0" * 2**26), "unpacks to more than"),
    ],
    ids=["no gzip", "cut short", "bomb"],  # packed bytes hold the time of day
)
def test_a_damaged_or_absurd_packed_table_is_refused(
    tmp_path: Path, content: bytes, said: str
) -> None:
    path = tmp_path / "fed.csv.gz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_tracks(path, source="long-table")
