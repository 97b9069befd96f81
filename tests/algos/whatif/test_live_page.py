"""The what-if page: its simulator step by step beside Python's, and the page in a browser."""

import base64
import hashlib
import json
import math
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import listen, serious_findings, unreachable_controls
from commands import animarl
from refusals import refuses
from slow import slowly
from small_runs import few, made

from animarl_algos import load_run
from animarl_algos.evaluation.collect import remembered
from animarl_algos.runs.run import Run
from animarl_algos.whatif.absent import (
    FewerWorld,
    Present,
    SubsetPolicy,
    farthest_pursuer,
    simulate_from,
)
from animarl_algos.whatif.live_page import SYNTHETIC, page_model, write_page
from animarl_algos.whatif.quantities import OUTCOMES
from animarl_algos.whatif.thrust_search import ThrustSearch
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting import custom_species
from animarl_envs.species.traits import Traits
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World
from tools.assemble_gemm import CONSTANT, PAGE

COPIES, STEPS = 4, 250  # 1,000 steps of every individual
COMPARE = """
const AnimaRL = require(process.argv[1]);
globalThis.Measures = require(process.argv[1].replace("engine.js", "measures.js"));
let text = "";
process.stdin.on("data", (part) => (text += part)).on("end", async () => {
  const { model: packed, log, copies, absent, tracks } = JSON.parse(text);
  const model = await AnimaRL.unpack(packed), K = model.individuals.length;
  if (log.pattern) Object.assign(model.starts, { pattern: log.pattern, phase: log.phase });
  const options = { ...AnimaRL.unchanged(model), absent };
  const world = AnimaRL.makeWorld(model, options, copies);
  const policy = new AnimaRL.Policy(model, copies);
  const all = [...Array(copies).keys()], flags = Int8Array.from(model.starts.condition);
  const off = { observation: 0, values: 0, position: 0, actions: 0, outcomes: 0 };
  const farthest = (key, there, here) => there.forEach((value, k) => {
    if (absent.includes(Math.floor((k * copies * K) / there.length) % K)) return;
    off[key] = Math.max(off[key], Math.abs(value - here[k]));
  });
  all.forEach((b) => world.begin(b, b));
  world.traits.set(log.traits);
  all.forEach((b) => world.observe(b));
  log.draws.forEach((draws, t) => {
    farthest("observation", log.observation[t], world.observation);
    policy.decide(world.observation, flags, all);
    farthest("values", log.values[t], policy.values);
    for (const b of all) {
      const executed = log.actions[t].slice(b * K, (b + 1) * K);
      executed.forEach((action, i) => {
        const chosen = policy.choose(b * K + i, i, draws[b * K + i]);
        if (!world.warming(b) && !absent.includes(i) && chosen !== action) off.actions += 1;
        policy.previous[b * K + i] = action;
      });
      world.step(b, executed);
      if (world.outcome[b] !== log.outcome[t][b]) off.outcomes += 1;
    }
    farthest("position", log.position[t], world.position);
  });
  const tasks = [...Array(60).keys()].map((k) => [k % model.starts.condition.length, k]);
  const { results } = await AnimaRL.rollOut(model, options, tasks, 0);
  off.duration = results.reduce((sum, one) => sum + one.duration, 0) / tasks.length;
  const usual = AnimaRL.unchanged(model);
  off.measures = tracks.map((one, k) => Measures.measure(model, usual, one.track, k, one.outcome));
  const some = (await AnimaRL.rollOut(model, options, tasks.slice(0, 2), 0, null, true)).results;
  off.measured = some.every((one) => Object.keys(one.measures).length > 20);
  off.simd = policy.products.gemm !== null;
  console.log(JSON.stringify(off));
});
"""


def node() -> str:
    """Node: that of the system, or the one that playwright brings."""
    if found := shutil.which("node"):
        return found
    driver = pytest.importorskip("playwright._impl._driver")
    return str(driver.compute_driver_executable()[0])


def recorded_steps(run: Run, removed: tuple[str, ...]) -> dict[str, Any]:
    """Draws, and what Python's world and networks make of them; the removed copy the first."""
    policy, K = run.policy.policy, len(run.scenario.species.individuals)
    there = source = np.arange(K)
    if removed:
        present = Present.without(run.scenario.species, removed)
        there, source = np.array(present.own), SubsetPolicy(run.policy, present).source
        demos = run.demos.of_individuals(present.own)
        scenario = run.starting_from("test", demos=demos, species=present.species)
        far = farthest_pursuer(run.demos.select(split="train"))
        world: World = FewerWorld(scenario, COPIES, present, far)
    else:
        world = make_world(run.scenario, COPIES)
    world.seed(np.arange(COPIES))
    world.reset(demo=np.arange(COPIES))
    rng = np.random.default_rng(0)
    names = ("draws", "actions", "values", "observation", "position", "outcome")
    log: dict[str, Any] = {name: [] for name in names}
    for name in ("pattern", "phase"):
        if hasattr(world, name):
            log[name] = getattr(world, name).tolist()
    traits = getattr(world, "traits", np.zeros((COPIES, K, 2)))
    log["traits"] = traits.reshape(COPIES, -1, 2)[:, source].ravel().tolist()
    state, starts = None, np.ones(COPIES * K, dtype=bool)
    for _ in range(STEPS):
        seen = world.observation[:, source].reshape(COPIES * K, -1)
        if run.has_condition_flag:
            flag = np.repeat(world.condition, K)[:, None].astype(seen.dtype)
            seen = np.concatenate([seen, flag], axis=1)
        values, hidden, _ = policy.advance(seen, state, starts)
        draws = rng.random(COPIES * K)
        asked = policy.acting.choose(values, draws, K).reshape(COPIES, K)
        done = world.executed(asked[:, there])[:, source]
        state = remembered(policy, (hidden, asked.ravel()), asked, done)
        log["draws"].append(draws.tolist())
        log["actions"].append(done.ravel().tolist())
        log["values"].append(values.ravel().tolist())
        log["observation"].append(world.observation[:, source].ravel().tolist())
        world.step(asked[:, there])
        log["position"].append(world.position[:, source].ravel().tolist())
        by = there[np.maximum(world.outcome, 1) - 1] + 1
        log["outcome"].append(np.where(world.outcome > 0, by, world.outcome).tolist())
        starts[:] = False
    return log


@pytest.mark.parametrize(
    "species, removed",
    [
        *((name, ()) for name in ("agent", "silkmoth", "solo", "shoal", "custom", "ring")),
        ("agent", ("predator_0",)),
        *slowly(("fly", ()), ("newt", ()), ("fly", ("male_1",))),  # chases as well
    ],
)
def test_parity_of_the_page_with_python(
    species: str, removed: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if species == "custom":  # animals that differ
        table = np.random.default_rng(0).normal(size=(8, 3, 2))
        traits = Traits(np.zeros((2, 3, 2)), np.ones((3, 2)), table)
        monkeypatch.setattr(custom_species, "fitted_traits", lambda _: traits)
    if species in ("solo", "shoal", "custom", "ring"):  # no trained model is packaged
        is_own = species in ("custom", "ring")
        demos = few("agent" if is_own else species, 4, 2, COPIES)
        own = {**demos.provenance, "synthetic": not is_own}
        demos = replace(demos, provenance=own, species="custom" if is_own else species)
        walls = {"rebound": True} if species == "ring" else {}
        if species == "ring":
            demos = replace(
                demos,
                arena=Arena(
                    "disc", 1.5, 1.6, inner=0.4, landmarks={"stripe": "0,1.5"},
                    obstacles=("0.8,0.8,0.2",),
                ),
            )  # fmt: skip
        made(
            tmp_path, "soft-bc", demos=demos, species=demos.species, rolled_out=False,
            env_kwargs=walls,
        )  # fmt: skip
        run = load_run(tmp_path / "soft-bc-0")
    else:
        run = load_run(species)
    given: dict[str, Any] = {"model": page_model(run), "copies": COPIES}
    given["log"] = recorded_steps(run, removed)
    given["absent"] = [run.scenario.species.individuals.index(name) for name in removed]
    whole = run.demos.select(split="test")
    given["tracks"] = [
        {
            "track": whole.positions[first:last].reshape(last - first, -1).tolist(),
            "outcome": int(end),
        }
        for first, last, end in zip(whole.offsets, whole.offsets[1:], whole.outcome)
    ]
    engine = resources.files("animarl_algos.whatif") / "page" / "engine.js"
    said = subprocess.run(
        [node(), "-e", COMPARE, str(engine)],
        input=json.dumps(given), capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    off = json.loads(said.stdout)
    assert off["simd"]
    assert off["actions"] == 0 and off["outcomes"] == 0
    assert off["observation"] < 1e-5 and off["position"] < 1e-9
    # In so few episodes an input of custom animals hardly varies (sd 3e-5, float32 rounds by 3e-7).
    rounding = 1e-3 if species in ("custom", "ring") else 1e-5
    assert off["values"] < rounding * max(1.0, np.abs(given["log"]["values"]).max())
    assert off["measured"]
    check_measures(given["model"], off["measures"])
    python = simulate_from(run, whole, removed, reading="habit", repetitions=5)
    assert off["duration"] == pytest.approx(
        ((python.lengths - 1) * python.dt).mean(), rel=0.35
    )  # of other random numbers


def check_measures(model: dict[str, Any], found: list[dict[str, float | None]]) -> None:
    """Assert that the page measures recordings as the verdict does, every measure of them."""
    judged = [one for one in model["quantities"] if one["kind"] != OUTCOMES]
    assert len(judged) > 20
    for one in judged:
        expected = model["recorded"]["measured"][one["name"]]
        scaled = [
            None if (value := each.get(one["name"])) is None else value * one["scale"]
            for each in found[: len(expected)]
        ]
        assert [value is None for value in scaled] == [value is None for value in expected]
        lengths = np.diff(model["recorded"]["offsets"])
        # Of the longest episode the package leaves out a pair of steps of this measure.
        longest = lengths.max() if one["name"].startswith("speed before turn") else math.inf
        pairs = zip(scaled, expected, lengths)
        known = [(a, b) for a, b, frames in pairs if b is not None and frames < longest]
        assert [a for a, _ in known] == pytest.approx([b for _, b in known], abs=2e-5), one["name"]


SEARCH = """
const { ThrustSearch } = require(process.argv[1]), [wanted, speeds] = JSON.parse(process.argv[2]);
const search = new ThrustSearch(wanted, 1);
const next = (speed) => (search.record(speed), search.advance(), search.factor);
console.log(JSON.stringify(speeds.map(next)));
"""


def test_the_page_searches_for_thrusts_as_the_command_does() -> None:
    speeds = np.random.default_rng(0).uniform(0.5, 3.0, 20).tolist()
    search, factors = ThrustSearch(1.3, 1.0), []
    for speed in speeds:
        search.record(speed)
        search.advance()
        factors.append(search.factor)
    command = [node(), "-e", SEARCH, str(PAGE / "engine.js"), json.dumps([1.3, speeds])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(done.stdout) == pytest.approx(factors, rel=1e-9)


def test_the_matrix_product_of_the_page_is_that_of_its_source() -> None:
    """``python tools/assemble_gemm.py`` writes it anew."""
    match = CONSTANT.search((PAGE / "engine.js").read_text(encoding="utf-8"))
    assert match is not None
    source, _, code = match.groups()
    assert source == hashlib.sha256((PAGE / "gemm.wat").read_bytes()).hexdigest()
    assert base64.b64decode(code).startswith(b"\0asm")


def test_what_a_page_cannot_carry_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    run = load_run("agent")
    whole = run.scenario

    def refusal(**changes: Any) -> str:
        monkeypatch.setitem(run.__dict__, "scenario", replace(whole, **changes))
        with pytest.raises(InputError) as refused:
            page_model(run)
        return str(refused.value)

    assert "noisy or late" in refusal(observation_noise=0.1)
    assert "only some individuals" in refusal(drivers=("action", "action", "replay"))
    monkeypatch.setattr("animarl_algos.whatif.live_page.MOST_INDIVIDUALS", 2)
    assert "3 individuals are more than the 2" in refusal()
    monkeypatch.setattr("animarl_algos.whatif.live_page.MOST_INDIVIDUALS", 60)
    moth = load_run("silkmoth")
    whole = moth.scenario
    traits = Traits(np.zeros((2, 1, 2)), np.ones((1, 2)), np.zeros((1, 1, 2)))
    for change, told in (
        ({"traits": traits}, "differ by traits or observe their past"),
        ({"senses_past": True}, "differ by traits or observe their past"),
        ({"plume": "off"}, "plume of the user's own"),
    ):
        unlike = replace(whole, species=replace(whole.species, **change))
        monkeypatch.setitem(moth.__dict__, "scenario", unlike)
        refuses(told, page_model, moth)


def test_a_page_that_is_too_large_is_refused_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("animarl_algos.whatif.live_page.MOST_BYTES", 1000)
    with pytest.raises(InputError, match=r"more than 0\.001: train a smaller network"):
        write_page(load_run("fly"), tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="--species fly goes with 'packaged'"):
        animarl("page", "agent", "--species", "fly", "--out", tmp_path / "page.html")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "fly.html"
    animarl("page", "packaged", "--species", "fly", "--out", file)
    assert file.stat().st_size < 5_000_000
    return file


@pytest.fixture
def page(browser: Any, page_file: Path) -> Iterator[Any]:
    said: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 900}, accept_downloads=True)
    opened = listen(context.new_page(), said)
    opened.goto(page_file.as_uri())
    answered(opened)
    yield opened
    context.close()
    assert said == []


def answered(page: Any) -> None:
    page.wait_for_function(
        "window.animarlPage && window.animarlPage.answered() && "
        "document.getElementById('progress').textContent.includes('of the changed world in')",
        timeout=60_000,
    )


def test_the_page_answers_to_its_sliders_and_keys(page: Any) -> None:
    rows = page.locator("#table tr")
    assert rows.count() == 7
    # Nothing is changed yet: not one number differs.
    assert all("0 [0, 0]" in text for text in rows.all_inner_texts())
    slider = page.locator("#control-contact")
    slider.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    page.wait_for_timeout(400)
    answered(page)
    duration = rows.nth(1).inner_text()
    assert duration.startswith("duration") and "0 [0, 0]" not in duration
    assert float(duration.split("\t")[4].split()[0]) < 0  # a wider reach ends episodes sooner
    page.click("#reset")
    page.wait_for_timeout(400)
    answered(page)
    assert "0 [0, 0]" in rows.nth(1).inner_text()


def test_the_page_is_worked_by_keys_alone(page: Any) -> None:
    assert unreachable_controls(page) == []
    page.focus("#steer")
    page.keyboard.press("ArrowDown")
    page.focus("#stage")
    before = page.evaluate("Array.from(window.animarlPage.episode().world.position)")
    page.keyboard.press("ArrowLeft")
    after = page.evaluate("Array.from(window.animarlPage.episode().world.position)")
    assert after[0] < before[0] and after[1:] == before[1:]
    page.keyboard.press(" ")
    assert page.inner_text("#play") == "Pause"
    page.focus("#restart")
    page.keyboard.press("Enter")
    assert page.inner_text("#play") == "Play"


def test_a_pursuer_is_taken_away_and_the_last_one_stays(page: Any) -> None:
    rows, one, other = map(page.locator, ("#table tr", "#control-there-0", "#control-there-1"))
    one.uncheck()
    page.wait_for_timeout(400)
    answered(page)
    names = [text.split("\t")[0] for text in rows.all_inner_texts()]
    assert "speed of male_1" in names and "speed of male_0" not in names
    assert "0 [0, 0]" not in rows.nth(1).inner_text() and other.is_disabled()
    warning = page.inner_text("#warning")
    assert "perceives what it never did in training: most often, " in warning
    assert "than ever in training" in warning or "new to it" in warning
    with page.expect_download() as download:
        page.click("#save")
    head = Path(download.value.path()).read_text().splitlines()[0]
    assert head == "time,male_1_x,male_1_y,female_x,female_y"
    page.click("#reset")
    page.wait_for_timeout(400)
    answered(page)
    assert rows.count() == 7 and one.is_checked() and other.is_enabled()


def test_landmarks_and_obstacles_are_dragged_hidden_and_added(browser: Any, tmp_path: Path) -> None:
    demos = few("agent", 4, 2, COPIES)
    arena = Arena("disc", 1.5, 1.6, landmarks={"lamp": "0.9,0"}, obstacles=("0,-1,0.2",))
    own = {**demos.provenance, "synthetic": False}
    demos = replace(demos, arena=arena, species="custom", provenance=own)
    made(tmp_path, "soft-bc", demos=demos, species="custom", rolled_out=False,
         env_kwargs={"rebound": True})  # fmt: skip
    file = write_page(load_run(tmp_path / "soft-bc-0"), tmp_path / "page.html")
    page, errors = browser.new_page(), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(file.as_uri())
    answered(page)
    stage = page.locator("#stage")
    stage.scroll_into_view_if_needed()
    box = stage.bounding_box()
    unit = box["width"] / 2 / (1.12 * 1.5)

    def world(name: str) -> list[list[float]]:
        return list(page.evaluate(f"window.animarlPage.episode().world.{name}"))

    def drag(first: list[float], last: list[float]) -> None:
        middle = box["x"] + box["width"] / 2, box["y"] + box["width"] / 2
        page.mouse.move(middle[0] + first[0] * unit, middle[1] - first[1] * unit)
        page.mouse.down()
        page.mouse.move(middle[0] + last[0] * unit, middle[1] - last[1] * unit)
        page.mouse.up()

    drag([0.9, 0.0], [0.9, 0.9])
    assert world("landmarks")[0] == pytest.approx([0.9, 0.9], abs=0.02)
    drag([0.0, -1.0], [-0.9, -0.9])
    assert world("holes")[0] == pytest.approx([-0.9, -0.9, 0.2], abs=0.02)
    page.wait_for_timeout(400)
    answered(page)
    assert any("0 [0, 0]" not in text for text in page.locator("#table tr").all_inner_texts())
    page.uncheck("#control-landmark-0")
    page.click("#more-obstacles")
    assert world("landmarks")[0] == [math.inf, math.inf] and len(world("holes")) == 2
    page.click("#reset")
    assert world("landmarks") == [[0.9, 0]] and world("holes") == [[0, -1, 0.2]]
    assert errors == []
    page.close()


@pytest.mark.slow
def test_two_hundred_episodes_of_the_packaged_chase_take_a_second(
    browser: Any, tmp_path: Path
) -> None:
    opened = browser.new_page()
    opened.goto(write_page(load_run("agent"), tmp_path / "agent.html").as_uri())
    seconds = []
    for seed in "12341":
        answered(opened)
        said = opened.inner_text("#progress")
        assert said.startswith("200 episodes of the changed world in ")
        seconds.append(float(said.split(" in ")[1].split(" s")[0]))
        opened.select_option("#seed", seed)
        opened.wait_for_timeout(400)
    opened.close()
    assert min(seconds) <= 1.0, seconds  # the least: others use the cores of this machine too


def test_an_animal_is_dragged_to_another_start(page: Any) -> None:
    assert page.locator("#histograms figure").count() == 6  # endings, duration, path, three speeds
    box = page.locator("#stage").bounding_box()
    unit = box["width"] / 2 / 1.12  # pixels per arena unit

    def places() -> list[float]:
        return list(page.evaluate("Array.from(window.animarlPage.episode().world.position)"))

    def pixels(x: float, y: float) -> tuple[float, float]:
        middle = box["width"] / 2
        return box["x"] + middle + x * unit, box["y"] + middle - y * unit

    before = places()
    page.mouse.move(*pixels(*before[:2]))
    page.mouse.down()
    page.mouse.move(*pixels(-0.4, 0.3), steps=3)
    page.mouse.up()
    after = places()
    assert after[:2] == pytest.approx([-0.4, 0.3], abs=0.01) and after[2:] == before[2:]


def wanted_speed(page: Any, individual: int, factor: float) -> tuple[str, float, float]:
    """Set a speed slider; what is said, and the achieved and the asked factor on the speed."""
    page.select_option("#body", "speed")
    slider = page.locator(f"#control-body-{individual}")
    slider.evaluate(
        "(one, factor) => { one.value = Math.log2(factor);"
        "one.dispatchEvent(new Event('input')); }", factor,
    )  # fmt: skip
    page.wait_for_function(
        "document.getElementById('progress').textContent.includes('Thrust ×')", timeout=60_000
    )
    name = page.evaluate(f"window.animarlPage.model.individuals[{individual}]")

    def mean(cell: str) -> float:
        return float(cell.split(" ±")[0])

    row = page.locator("#table tr", has_text=f"speed of {name}").inner_text().split("\t")
    assert page.locator(f"label[for=control-body-{individual}]").inner_text() == f"Speed of {name}"
    set_to = 2 ** float(slider.input_value())
    return page.inner_text("#progress"), mean(row[3]) / mean(row[2]), set_to


@pytest.mark.slow
def test_a_speed_slider_finds_the_thrust_that_python_finds(browser: Any, tmp_path: Path) -> None:
    run = load_run("agent")
    opened = browser.new_page()
    opened.goto(write_page(run, tmp_path / "agent.html").as_uri())
    answered(opened)
    said, achieved, asked = wanted_speed(opened, 2, 1.2)
    opened.close()
    assert achieved == pytest.approx(asked, rel=0.03)
    thrust = float(said.split("Thrust × ")[1].split(" ")[0])
    python = run.what_if(f"prey.speed=x{asked:.4f}").answers[0].thrusts["prey"]
    assert thrust == pytest.approx(python, rel=0.15)


def test_a_speed_that_no_thrust_gives_is_said(page: Any) -> None:
    said, achieved, asked = wanted_speed(page, 0, 0.8)  # a fly coasts for longer than it pushes
    assert "no thrust was found" in said and abs(achieved / asked - 1) > 0.02


def test_a_reader_steers_an_animal_and_its_track_is_imported(page: Any, tmp_path: Path) -> None:
    page.select_option("#steer", "2")
    page.focus("#stage")
    page.keyboard.down("ArrowRight")
    before = page.evaluate("Array.from(window.animarlPage.episode().world.position)")
    page.evaluate("for (let k = 0; k < 8; k++) window.animarlPage.step()")
    page.keyboard.up("ArrowRight")
    after = page.evaluate("Array.from(window.animarlPage.episode().world.position)")
    assert after[4] > before[4] and abs(after[5] - before[5]) < 0.6 * (after[4] - before[4])
    page.evaluate("for (let k = 0; k < 60; k++) window.animarlPage.step()")
    with page.expect_download() as download:
        page.click("#save")
    track = tmp_path / "track.csv"
    download.value.save_as(track)
    animarl(
        "import", track, "--fps", "10", "--target", "female", "--arena", "disc",
        "--arena-width", "2", "--out", tmp_path / "own.npz",
    )  # fmt: skip
    own = Demonstrations.load(tmp_path / "own.npz")
    assert set(own.individuals) == {"male_0", "male_1", "female"}
    steps = page.evaluate("window.animarlPage.episode().world.steps[0]")
    assert own.lengths.sum() == pytest.approx(steps + 1, abs=2)


def test_the_page_fits_a_phone_and_axe_finds_nothing_serious(browser: Any, page_file: Path) -> None:
    for width, scheme in ((390, "light"), (1280, "dark")):
        context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme)
        opened = context.new_page()
        opened.goto(page_file.as_uri())
        answered(opened)
        assert opened.evaluate("document.documentElement.scrollWidth") <= width
        assert serious_findings(opened) == [], (width, scheme)
        context.close()


def test_synthetic_recordings_are_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = load_run("silkmoth")
    assert SYNTHETIC in write_page(run, tmp_path / "page.html").read_text()
    model = page_model(run) | {"synthetic": False}
    monkeypatch.setattr("animarl_algos.whatif.live_page.page_model", lambda run: model)
    assert SYNTHETIC not in write_page(run, tmp_path / "own.html").read_text()


def test_hostile_names_stay_text(
    tmp_path: Path, browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    hostile, model = "</script><img src=x onerror=alert(1)>__DATA__", page_model(load_run("agent"))
    names = [f"{hostile}{k}" for k in range(3)]
    measured = model["recorded"]["measured"]
    for name, other in zip(model["individuals"], names, strict=True):
        measured[f"speed of {other}"] = measured.pop(f"speed of {name}")
        for one in model["quantities"]:
            one["name"] = one["name"].replace(f"speed of {name}", f"speed of {other}")
    model |= {"individuals": names, "conditions": [hostile, "__STYLE__"]}
    monkeypatch.setattr("animarl_algos.whatif.live_page.page_model", lambda run: model)
    file = write_page(load_run("agent"), tmp_path / "page.html", title=hostile)
    said: list[str] = []
    opened = listen(browser.new_page(), said)
    opened.on("dialog", lambda dialog: (said.append(dialog.message), dialog.dismiss()))
    opened.goto(file.as_uri())
    answered(opened)
    assert said == [] and opened.locator("img").count() == 0
    assert hostile in opened.inner_text("h1") and hostile in opened.title()
    assert f"speed of {names[2]}" in opened.inner_text("#table")
    assert opened.locator("#condition option").all_inner_texts()[1:] == [hostile, "__STYLE__"]
    opened.close()
