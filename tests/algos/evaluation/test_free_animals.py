"""Measures of groups and of one animal alone, where nobody is pursued."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import episodes_along

from animarl_algos.evaluation.classifier import window_features
from animarl_algos.evaluation.collect import Blindfolded, MemorylessPolicy
from animarl_algos.evaluation.metrics import (
    BETWEEN_ANIMALS,
    INTERACTIVE,
    METRICS,
    compared_metrics,
    judged_metrics,
)
from animarl_algos.evaluation.order_in_time import order_measures
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.realism import Likelihood
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import Verdict, verdict
from animarl_algos.evaluation.verdict_rows import DIFFERS
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.focus import nearest_other
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world
from tools.packaged_data import larva, shoal

ANIMALS, GROUPS, STEPS = 6, 12, 80
TANK = Arena("disc", 1.0, 1.1, rebound=True)
LAW = shoal.ZonalLaw()
GROUP_ROWS = {
    "nearest_neighbour", "near_neighbour", "extent", "polarisation", "milling", "leadership_lag",
    "speed_correlation",
}  # fmt: skip


def recorded(paths: list[np.ndarray], arena: Arena, dt: float) -> Demonstrations:
    """Demonstrations of the test split that merely end, of animals that are no targets."""
    num = paths[0].shape[1]
    return episodes_along(
        paths, species="custom", individuals=tuple(f"animal_{k}" for k in range(num)),
        roles=("pursuer",) * num, dt=dt, arena=arena, outcome=np.full(len(paths), UNFINISHED),
        initial_velocity=np.array([(path[1] - path[0]) / dt for path in paths]),
    )  # fmt: skip


def rollouts_of(demos: Demonstrations, paths: list[np.ndarray], each: int) -> Rollouts:
    """Rollouts of a simulator, ``each`` from every start."""
    count = len(demos)
    first = Rollouts.from_demonstrations(demos).select(np.tile(np.arange(count), each))
    return replace(
        first, positions=np.concatenate(paths), method="simulator", seed=np.zeros(len(paths)),
        repetition=np.repeat(np.arange(each), count),
    )  # fmt: skip


@pytest.fixture(scope="module")
def group() -> Demonstrations:
    paths = shoal.simulate(LAW, GROUPS, ANIMALS, STEPS + 60, np.random.default_rng(1))
    return recorded(list(paths[:, 60:] / LAW.tank), TANK, LAW.dt)


@pytest.fixture(scope="module")
def larvae() -> Demonstrations:
    paths = larva.simulate(larva.RunAndTurnLaw(), 30, 151, 0.2, np.random.default_rng(2))
    return recorded([path[:, None] for path in paths], Arena("open", 20.0), 0.2)


def measured(path: np.ndarray, dt: float = 0.1) -> dict[str, float]:
    """Every measure of one group."""
    rollouts = Rollouts.from_demonstrations(recorded([path, path], TANK, dt))
    found = order_measures(rollouts, (5, 20), np.zeros(path.shape[1]), TANK)
    return dict(zip(found.names, found.values[0]))


def test_measures_of_groups_have_known_values() -> None:
    time, place = np.arange(81)[:, None] * 0.05, 2 * np.pi * np.arange(4) / 4
    ring = 0.5 * np.stack([np.cos(time + place), np.sin(time + place)], axis=-1)
    mill = measured(ring)
    assert mill["milling"] == pytest.approx(1.0, abs=0.01)
    assert mill["polarisation"] == pytest.approx(0.0, abs=1e-9)
    assert mill["extent of the group"] == pytest.approx(0.5)
    assert mill["nearest neighbour"] == pytest.approx(np.sqrt(0.5))
    assert mill["5 % nearest neighbour"] == pytest.approx(np.sqrt(0.5))
    # Three go the same way; the fourth turned there half a second before.
    way = np.cumsum(np.random.default_rng(0).normal(0.0, 0.3, 86))
    lagging = np.stack([way[:-5], way[:-5], way[:-5], way[5:]], axis=1)
    steps = 0.01 * np.stack([np.cos(lagging), np.sin(lagging)], axis=-1)
    start = np.array([[0, 0], [0.1, 0], [0, 0.1], [0.1, 0.1]])
    led = measured(start + np.concatenate([np.zeros((1, 4, 2)), np.cumsum(steps, axis=0)]))
    together = np.repeat(steps[:, :1], 4, axis=1)
    same = measured(start + np.concatenate([np.zeros((1, 4, 2)), np.cumsum(together, axis=0)]))
    assert same["polarisation"] == pytest.approx(1.0) and same["leadership lag"] == 0.0
    assert np.isnan(same["speed with the others"])  # speeds do not vary
    # The leader is half a second ahead, on a grid of .2 s, and the others are with each other.
    assert led["leadership lag"] == pytest.approx(0.5 / 4, abs=0.03)


def test_how_animals_of_a_group_differ_is_measured(group: Demonstrations) -> None:
    """Spreads between animals have known values; a simulator of equal animals is caught by them."""
    time = 0.1 * np.arange(41)[:, None]
    lanes = np.stack([np.tile([0.0, 0.1, 0.2, 0.4], (41, 1)), time * [0.1, 0.1, 0.2, 0.2]], axis=-1)
    lanes[:, 3, 1] = 0.0  # it rests
    known = measured(lanes)
    assert known["spread of speed between animals"] == pytest.approx(np.std([0.1, 0.1, 0.2, 0.0]))
    assert known["spread of share at rest between animals"] == pytest.approx(np.std([0, 0, 0, 1]))
    assert known["spread of turning between animals"] == pytest.approx(0.0, abs=1e-9)
    assert known["spread of nearest neighbour between animals"] > 0
    assert known["spread of distance from the wall between animals"] > 0

    rng, start = np.random.default_rng(3), group.positions[group.offsets[:-1]]
    factor = rng.uniform(0.2, 1.8, size=(len(group), 1, ANIMALS, 1))
    steps = 0.005 * rng.normal(size=(2, len(group), 60, ANIMALS, 2))
    unlike = start[:, None] + np.cumsum(factor * steps[0], axis=1)
    equal = start[:, None] + np.cumsum(1.12 * steps[1], axis=1)
    demos = recorded(list(unlike), TANK, LAW.dt)
    row = judge(demos, list(equal), 1).row(BETWEEN_ANIMALS)
    assert row["judgement"] == DIFFERS and row["simulated"] < row["recorded"]
    assert "differ too little" in row["verdict"]


def test_measures_of_a_group_do_not_depend_on_who_is_who(group: Demonstrations) -> None:
    """Animals that are alike are measured as one kind, in columns that grow with no animal."""
    rollouts = Rollouts.from_demonstrations(group)
    dealt = np.random.default_rng(0).permutation(ANIMALS)
    other = replace(rollouts, positions=rollouts.positions[:, dealt])
    sides = [order_measures(r, (5, 20), np.zeros(ANIMALS), TANK) for r in (rollouts, other)]
    np.testing.assert_allclose(sides[0].values, sides[1].values, atol=1e-12)
    assert not any("animal" in name.split(", ")[-1] for name in sides[0].names if "," in name)
    windows = window_features(rollouts, TANK)
    few = replace(
        rollouts, positions=rollouts.positions[:, :3], individuals=rollouts.individuals[:3],
        roles=rollouts.roles[:3],
    )  # fmt: skip
    assert windows.values.shape[1] == window_features(few, TANK).values.shape[1]
    assert len(windows) == 2 * len(window_features(few, TANK))


def test_the_nearest_other_is_that_of_all_pairs() -> None:
    points = np.random.default_rng(0).normal(size=(5, 7, 2))
    apart = points[:, None] - points[:, :, None]
    distance = np.linalg.norm(apart, axis=-1)
    distance[:, np.arange(7), np.arange(7)] = np.inf
    np.testing.assert_allclose(
        np.linalg.norm(nearest_other(points), axis=-1), distance.min(axis=-1)
    )


def judge(demos: Demonstrations, paths: list[np.ndarray], each: int) -> Verdict:
    return verdict(demos, rollouts_of(demos, paths, each), seed=0)


@pytest.mark.slow
def test_a_shoal_is_judged_as_a_group(group: Demonstrations) -> None:
    """A true simulator is not told from it; animals that do not see each other are."""
    same = [path for seed in (11, 12) for path in _from_starts(group, seed, LAW)]
    blind = replace(LAW, repulsion=0.0, orientation=0.0, attraction=0.0)
    alone = [path for seed in (11, 12) for path in _from_starts(group, seed, blind)]
    control = {"blind": rollouts_of(group, alone, 2)}
    true = verdict(group, rollouts_of(group, same, 2), seed=0, baselines=control)
    wrong = judge(group, alone, 2)
    rows = set(true.table["measure"])
    assert rows > GROUP_ROWS
    assert not rows & {"reached", "target_out", "pursuer_out", "outcomes", "duration", "rests"}
    judged = true.table.set_index("measure")["judgement"]
    assert not (judged[list(GROUP_ROWS)] == DIFFERS).any()
    extent = true.row("extent")
    assert abs(extent["simulated"] - extent["recorded"]) < 0.1 * extent["recorded"]
    assert extent["strangers"] > 1.5 * extent["recorded"]
    assert extent["blind"] == wrong.row("extent")["simulated"] > 1.2 * extent["recorded"]
    assert "blind" not in wrong.table
    assert wrong.row("extent")["judgement"] == "differs"
    assert any(said.startswith(("spread too wide", "align too")) for said in wrong.complaints)
    realism = Likelihood.of(Prepared(group))
    chosen = [
        realism.by_kind(realism.components(rollouts_of(group, paths, 2))) for paths in (same, alone)
    ]
    assert chosen[0][INTERACTIVE] > chosen[1][INTERACTIVE] + 0.1


def _from_starts(demos: Demonstrations, seed: int, law: shoal.ZonalLaw) -> list[np.ndarray]:
    """Shoals that go on from the starts of recorded ones."""
    first = np.stack([demos.path(i)[0] for i in range(len(demos))]) * law.tank
    velocity = demos.initial_velocity
    heading = np.arctan2(velocity[..., 1], velocity[..., 0])
    rng = np.random.default_rng(seed)
    return list(shoal.continued(law, first, heading, STEPS, rng) / law.tank)


def test_one_animal_is_judged_by_how_far_it_gets(larvae: Demonstrations) -> None:
    rng = np.random.default_rng(3)
    law = larva.RunAndTurnLaw()
    same = [path[:, None] for path in larva.simulate(law, 60, 151, 0.2, rng)]
    restless = replace(law, turn_rate=1.0)
    wrong = [path[:, None] for path in larva.simulate(restless, 60, 151, 0.2, rng)]
    true, false = judge(larvae, same, 2), judge(larvae, wrong, 2)
    far = [name for name in true.table["measure"] if name.startswith("displacement")]
    assert len(far) >= 3 and "rests" in set(true.table["measure"])
    assert not set(true.table["measure"]) & {"interactive", "reached", "duration", "extent"}
    judged = {name: false.row(name)["judgement"] for name in far}
    assert judged[far[-1]] == "differs" and any(
        said.startswith("does not get far enough: ") for said in false.complaints
    )
    assert not any(true.row(name)["judgement"] == DIFFERS for name in far)


def test_metrics_follow_the_kind_of_data(group: Demonstrations, larvae: Demonstrations) -> None:
    chase = replace(group, roles=(*group.roles[:-1], "target"))
    of = {
        name: {metric.key for metric in judged_metrics(Prepared(demos)) if not metric.kind}
        for name, demos in (("group", group), ("animal", larvae), ("chase", chase))
    }
    assert "reached" in of["chase"] and not of["chase"] & GROUP_ROWS
    assert of["group"] > GROUP_ROWS and "reached" not in of["group"] | of["animal"]
    assert "reached" not in {metric.key for metric in compared_metrics(group)}
    assert len({metric.key for metric in METRICS}) == len(METRICS)


def test_the_laws_of_the_programs_are_recovered() -> None:
    """Zone radii of the shoal and the turn rate of the larva, within a tenth."""
    rng = np.random.default_rng(4)
    paths = shoal.simulate(LAW, 30, 12, 250, rng)[:, 50:]
    found = shoal.recovered_radii(LAW, paths, rng)
    for name in shoal.RADII:
        assert found[name] == pytest.approx(getattr(LAW, name), rel=0.1), name
    law = larva.RunAndTurnLaw()
    tracks = larva.simulate(law, 150, 201, 0.2, rng)
    rate = larva.recovered_turn_rate(law, list(tracks), 0.2)
    assert rate == pytest.approx(law.turn_rate, rel=0.1)


def test_the_blind_control_sees_the_neighbours_of_another() -> None:
    """What it is shown of the others is another animal's; what it knows of itself stays."""
    world = make_world(make_scenario("shoal"), 3)
    world.seed([0, 1, 2])
    world.reset(demo=np.arange(3))
    names = [one.name for one in world.observation_components]
    seen = world.observation.reshape(36, -1)
    shown: list[np.ndarray] = []

    class Watching(MemorylessPolicy):
        def act(self, observation: np.ndarray) -> np.ndarray:
            shown.append(observation)
            return np.zeros(len(observation), dtype=np.int64)

    Blindfolded(Watching(), names).predict(seen)
    others = np.array([name.startswith("other ") for name in names])
    np.testing.assert_array_equal(shown[0][:, ~others], seen[:, ~others])
    of = [
        np.flatnonzero((seen[:, others] == row).all(axis=1)).item() for row in shown[0][:, others]
    ]
    assert sorted(of) == list(range(36))
    apart = np.array(of) // 12 != np.arange(36) // 12
    assert apart.all() and (np.array(of) % 12 != np.arange(36) % 12).all()
