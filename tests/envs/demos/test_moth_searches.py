"""The packaged Silkmoth demonstrations: what they hold, and that their plume is really theirs."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from refusals import refuses

import animarl_envs  # noqa: F401  (registers the ids)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import FOLDER, load_packaged
from animarl_envs.locomotion import infer_actions
from animarl_envs.species import SILKMOTH
from tools.packaged_data.moth_comparison import comparison, rates
from tools.packaged_data.moth_published import PUBLISHED
from tools.packaged_data.moth_searches import SPLIT_OF_PATTERN, generate, search
from tools.packaged_data.moth_statistics import (
    describe,
    of_demonstrations,
    of_searches,
    recorded_moths,
    wasserstein,
)

UPWIND = np.array([-1.0, 0.0])


@pytest.fixture(scope="module")
def packaged() -> Demonstrations:
    return load_packaged("silkmoth")


# -- what the file holds --------------------------------------------------------------------------


def test_sixty_synthetic_episodes_under_two_megabytes(packaged: Demonstrations) -> None:
    assert (FOLDER / "silkmoth.npz").stat().st_size < 2e6
    assert packaged.synthetic
    assert "programmed moths" in str(packaged.provenance["source"])
    assert packaged.individuals == ("moth",) and packaged.roles == ("searcher",)
    assert packaged.dt == SILKMOTH.dt
    assert np.bincount(packaged.condition).tolist() == [30, 30]


def test_no_split_shares_a_plume_with_another(packaged: Demonstrations) -> None:
    plume = packaged.signals["plume"][packaged.offsets[:-1]]
    plumes = {s: set(plume[packaged.split == s].tolist()) for s in ("train", "val", "test")}
    assert plumes == {"train": {0, 1, 2}, "val": {3}, "test": {4}}
    assert plumes["train"] == set(SILKMOTH.train_plumes)
    sizes = [(packaged.split == s).sum() for s in ("train", "val", "test")]
    assert sizes == [36, 12, 12]
    for number, split in enumerate(SPLIT_OF_PATTERN):
        of_one = plume == number
        assert of_one.sum() == 12 and packaged.condition[of_one].sum() == 6
        assert set(packaged.split[of_one]) == {split}
        assert len(set(packaged.recording[of_one])) == 1


def test_actions_are_those_of_the_inverse_dynamics(packaged: Demonstrations) -> None:
    for episode in packaged:
        velocity = episode.velocities[:, 0]
        found = infer_actions(
            velocity[:-1], velocity[1:], UPWIND, SILKMOTH.locomotion[0], SILKMOTH.dt
        )
        np.testing.assert_array_equal(found, episode.signals["actions"][:-1, 0])
        assert episode.signals["actions"][-1, 0] == -1


# -- how moth-like they are -----------------------------------------------------------------------


def test_statistics_lie_near_the_published_ones(packaged: Demonstrations) -> None:
    full, reduced = (of_demonstrations(packaged.select(condition=c)) for c in (0, 1))
    assert full.rate == pytest.approx(PUBLISHED.reached_full, abs=0.05)
    assert reduced.rate == pytest.approx(PUBLISHED.reached_reduced, abs=0.05)
    duration = np.concatenate([full.duration, reduced.duration])
    assert duration.sum() == pytest.approx(PUBLISHED.total, rel=0.2)
    assert duration.min() == pytest.approx(PUBLISHED.shortest, abs=10.0)
    assert reduced.path.mean() - full.path.mean() > 0.5


@pytest.mark.realdata
def test_statistics_lie_near_those_of_recorded_moths(
    packaged: Demonstrations, data_dir: Path
) -> None:
    recorded = of_demonstrations(recorded_moths(data_dir / "silkmoth_mothvr"))
    assert len(recorded.reached) == 24 and recorded.reached.sum() == 22
    full = of_demonstrations(packaged.select(condition=0))
    assert wasserstein(full.speed, recorded.speed) < 0.001
    assert wasserstein(full.turning, recorded.turning) < 0.7
    assert np.median(full.speed) == pytest.approx(np.median(recorded.speed), rel=0.25)
    rows = comparison(packaged, recorded)
    assert len({len(row) for row in rows}) == 1
    assert any(f"{recorded.rate:.3f}" in row for row in rows)


def test_statistics_of_a_known_track() -> None:
    """A quarter circle of 90 steps of one degree, then a stop."""
    angle = np.deg2rad(np.arange(91.0))
    track = 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    track = np.concatenate([track, np.repeat(track[-1:], 10, axis=0)])
    found = describe([track, track[:11]], np.array([True, False]), 0.5)
    chord = 2 * 0.3 * np.sin(np.deg2rad(0.5))
    np.testing.assert_allclose(found.duration, [50.0, 5.0])
    np.testing.assert_allclose(found.path, [90 * chord, 10 * chord])
    assert found.resting == pytest.approx(10 / 110)
    np.testing.assert_allclose(found.turning, np.deg2rad(1.0) / 0.5, rtol=1e-9)
    assert len(found.turning) == 89 + 9
    assert found.rate == 0.5
    assert wasserstein(np.array([1.0, 2.0]), np.array([1.5, 2.5])) == pytest.approx(0.5)


# -- how they are made ----------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    first, again = (generate(3, trials=1).save(tmp_path / name) for name in ("a.npz", "b.npz"))
    assert first.read_bytes() == again.read_bytes()
    other = generate(4, trials=1)
    assert other.fingerprint() != Demonstrations.load(first).fingerprint()
    assert other.num_episodes == 10
    np.testing.assert_array_equal(
        Demonstrations.load(first).positions, generate(3, trials=1).positions
    )


def test_the_packaged_file_is_what_the_command_makes(packaged: Demonstrations) -> None:
    made = generate(int(packaged.provenance["seed"]))
    np.testing.assert_array_equal(made.lengths, packaged.lengths)
    np.testing.assert_array_equal(made.outcome, packaged.outcome)
    np.testing.assert_allclose(made.positions, packaged.positions, atol=1e-9)


def test_searches_end_where_they_end() -> None:
    found = search(SILKMOTH, 0, episodes=12, seed=2)
    assert set(found.pattern.tolist()) <= set(SILKMOTH.train_plumes)
    for track, reached in zip(found.tracks(), found.reached, strict=True):
        assert (np.linalg.norm(track[-1]) < SILKMOTH.contact_radius) == reached
    assert of_searches(found).rate == found.reached.mean()
    refuses("episodes is 0", search, SILKMOTH, 0, episodes=0, seed=0)


def test_table_of_rates_has_a_row_per_case() -> None:
    head, rows = rates(8, 0, None)
    assert len(rows) == 6 and {len(row) for row in [head, *rows]} == {5}
    assert " of 8 = " in rows[0][2]


def test_a_folder_without_runs_is_refused(tmp_path: Path) -> None:
    refuses(r"no raw/\*\.csv", recorded_moths, tmp_path)


def test_a_plume_without_its_demonstrations_is_refused_with_the_mend() -> None:
    own = {"train_plumes": (0,), "test_plumes": (4,)}
    refuses("pattern 1, .* or pass demos=None", gym.make, "AnimaRL/Silkmoth-v0", **own)
    env = gym.make("AnimaRL/Silkmoth-v0", train_plumes=(0,), demos=None)
    assert env.reset(seed=0)[1]["demo"] == -1
