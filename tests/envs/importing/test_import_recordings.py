"""The recordings at hand, imported: counts, outcomes and fits; the examples of the pages."""

from pathlib import Path

import numpy as np
import pytest

from animarl_envs.demos import Demonstrations
from animarl_envs.fitting import fit_locomotion, transitions
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import default_recipe, follow, get_reader
from animarl_envs.locomotion import Locomotion
from tools.packaged_data.moth_comparison import RECORDED_FIT


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
    assert Locomotion(round(fit.damping, 3), round(fit.thrust, 4)) == RECORDED_FIT


@pytest.mark.realdata
@pytest.mark.parametrize("as_recorded", [False, True])
def test_import_of_termite_pairs_cut_from_three_to_one_body_length(
    as_recorded: bool, data_dir: Path
) -> None:
    path = data_dir / "termite_tandem" / "tracks_30fps_int16.npz"
    counts = {}
    for kind, body in (("Cf", 8.89), ("Rs", 5.5)):
        recipe = default_recipe(get_reader("termites"), options={"kind": kind}).to_dict()
        radius = 72.5  # of the dish [mm]
        recipe["scaling"] |= {"width": 2 * radius, "boundary": 2.0}  # a jump leads out of the dish
        recipe["cutting"] |= {
            "mode": "approach", "farther_than": 3 * body / radius, "closer_than": body / radius,
        }  # fmt: skip
        if as_recorded:
            recipe |= {"decision_rate": None, "cleaning": {}}
        demos = follow(ImportRecipe.from_dict(recipe), [path])
        counts[kind] = demos.num_episodes
        assert demos.roles == ("pursuer", "target") and demos.individuals == ("male", "female")
    assert counts == ({"Cf": 82, "Rs": 58} if as_recorded else {"Cf": 75, "Rs": 57})


@pytest.mark.realdata
def test_import_of_the_sleap_clip_agrees_with_its_plain_array(data_dir: Path) -> None:
    from animarl_envs.importing.readers import read_tracks

    folder = data_dir / "fly_courtship_sleapclip"
    (tracks,) = read_tracks(folder / "clip.2node.slp")
    with np.load(folder / "clip_2node_tracks.npz") as plain:
        np.testing.assert_array_equal(tracks.positions, plain["xy"].astype(np.float64))
        assert list(tracks.individuals) == plain["tracks"].tolist()


@pytest.mark.realdata
def test_a_shorter_last_interval_makes_no_slower_animal(moths: Demonstrations) -> None:
    """The last frame of a search is kept although it falls between decisions."""
    interval, last = moths.intervals(), moths.offsets[1:] - 1
    assert (interval[last] < moths.dt).mean() > 0.5
    assert np.allclose(np.delete(interval, last), moths.dt)
    moved = np.linalg.norm(moths.positions[last, 0] - moths.positions[last - 1, 0], axis=1)
    speed = np.linalg.norm(moths.velocities()[last, 0], axis=1)
    np.testing.assert_allclose(speed, moved / interval[last])
    assert speed[0] == np.linalg.norm(moths.episode(0).velocities[-1])
    fewer = (interval[last] < 0.999 * moths.dt).sum()
    assert len(transitions(moths, 0)) == (moths.lengths - 1).sum() - fewer
