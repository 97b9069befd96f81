"""The recordings at hand, imported: counts, outcomes and fits; the examples of the pages."""

from __future__ import annotations

import glob
import itertools
from pathlib import Path

import numpy as np
import pytest
from test_import import animarl

from animarl_envs.demos import Demonstrations
from animarl_envs.demos.following import follow
from animarl_envs.demos.readers import default_recipe, get_reader, read
from animarl_envs.demos.recipe import Recipe
from animarl_envs.fitting import LocomotionFit, fit_locomotion


@pytest.fixture(scope="module")
def moths(data_dir: Path) -> Demonstrations:
    files = sorted((data_dir / "silkmoth_mothvr" / "raw").glob("*.csv"))
    return follow(default_recipe(get_reader("mothvr")), files)


@pytest.mark.realdata
def test_import_of_silkmoth_runs(moths: Demonstrations) -> None:
    assert moths.num_episodes == 24
    assert (moths.outcome == 1).sum() == 22 and (moths.outcome == 0).sum() == 2
    assert np.linalg.norm(moths.positions, axis=2).max() < 0.5  # metres
    last = moths.positions[moths.offsets[1:] - 1, 0]
    assert np.linalg.norm(last[moths.outcome == 1], axis=1).max() < 0.0512
    assert not (moths.lengths > 601).any()


@pytest.mark.realdata
def test_onset_fit_of_silkmoth_runs_is_near_the_published_reanalysis(moths: Demonstrations) -> None:
    (fit,) = fit_locomotion(moths, "onset", split=None).individuals
    assert fit.damping == pytest.approx(0.341, abs=0.005)
    assert fit.thrust == pytest.approx(0.0171, abs=0.0002)


@pytest.mark.realdata
def test_import_of_termite_pairs_cut_from_three_to_one_body_length(data_dir: Path) -> None:
    path = data_dir / "termite_tandem" / "tracks_30fps_int16.npz"
    counts = {}
    for kind, body in (("Cf", 8.89), ("Rs", 5.5)):
        recipe = default_recipe(get_reader("termites"), options={"kind": kind}).to_dict()
        radius = 72.5  # of the dish [mm]
        recipe["scaling"] |= {"width": 2 * radius, "boundary": 1.3}
        recipe["cutting"] |= {
            "mode": "approach", "farther_than": 3 * body / radius, "closer_than": body / radius,
        }  # fmt: skip
        demos = follow(Recipe.from_dict(recipe), [path])
        counts[kind] = demos.num_episodes
        assert demos.roles == ("pursuer", "target") and demos.individuals == ("male", "female")
    assert counts == {"Cf": 75, "Rs": 57}


def _pooled(fit: LocomotionFit) -> float:
    return float(np.sqrt(np.mean([one.velocity_rmse**2 for one in fit.individuals])))


@pytest.mark.realdata
def test_joint_fit_rmse_is_below_onset_fit_rmse(moths: Demonstrations, data_dir: Path) -> None:
    sleap = read(
        data_dir / "fly_courtship_sleapclip" / "clip.2node.slp", frame_rate=25.0, target="female"
    )
    flies = read(
        data_dir / "fly_groups12" / "tracks_24fps_int16.npz",
        individuals=["fly_1", "fly_2", "fly_3"],
    )
    for demos in (moths, sleap, flies):
        split = "train" if demos.num_episodes > 1 else None
        joint = fit_locomotion(demos, "joint", split=split, bootstrap=0)
        onset = fit_locomotion(demos, "onset", split=split, bootstrap=0)
        assert _pooled(joint) < _pooled(onset)


@pytest.mark.realdata
@pytest.mark.slow
def test_joint_fit_rmse_is_below_onset_fit_rmse_on_termites(data_dir: Path) -> None:
    path = data_dir / "termite_tandem" / "tracks_30fps_int16.npz"
    for kind in ("Cf", "Rs"):
        demos = read(path, kind=kind, scaling={"shape": "disc", "width": 145.0, "boundary": 1.3})
        joint = fit_locomotion(demos, "joint", bootstrap=0)
        onset = fit_locomotion(demos, "onset", bootstrap=0)
        for one, other in zip(joint.individuals, onset.individuals, strict=True):
            assert one.velocity_rmse < other.velocity_rmse


@pytest.mark.realdata
def test_import_of_the_sleap_clip_agrees_with_its_plain_array(data_dir: Path) -> None:
    from animarl_envs.demos.readers import read_tracks

    folder = data_dir / "fly_courtship_sleapclip"
    (tracks,) = read_tracks(folder / "clip.2node.slp")
    with np.load(folder / "clip_2node_tracks.npz") as plain:
        np.testing.assert_array_equal(tracks.positions, plain["xy"].astype(np.float64))
        assert list(tracks.individuals) == plain["tracks"].tolist()


DOCS = Path(__file__).resolve().parents[1] / "docs" / "data"


@pytest.mark.realdata
@pytest.mark.parametrize("number", range(4))
def test_worked_examples_of_the_data_pages(
    number: int, data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "examples.md").read_text()
    blocks = [part.split("```")[0] for part in text.split("```console\n")[1:]]
    assert len(blocks) == 4
    for line in blocks[number].splitlines():
        words = line.removeprefix("$ animarl ").replace("$DATA", str(data_dir)).split()
        said = animarl(*itertools.chain.from_iterable(map(_expanded, words)))
        assert said.strip()
    assert len(list(tmp_path.glob("*.png"))) == len(list(tmp_path.glob("*.recipe.yaml"))) == 1


def _expanded(word: str) -> list[str]:
    return sorted(glob.glob(word)) if "*" in word else [word]  # noqa: PTH207 (absolute pattern)


def test_python_of_the_data_pages_runs() -> None:
    for page in ("cleaning.md", "readers.md"):
        for part in (DOCS / page).read_text().split("```python\n")[1:]:
            exec(compile(part.split("```")[0], page, "exec"), {"__name__": page})
    from animarl_envs.demos.readers import registry

    assert "two-columns" in {reader.name for reader in registry.available_readers()}
    registry._READERS.pop("two-columns")
