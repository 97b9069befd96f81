"""``animarl import``, ``animarl data`` and ``animarl fit``: from file to file, all or nothing."""

import csv
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from commands import animarl
from recordings import write_tracks
from refusals import refuses
from small_runs import few, made

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.cleaning import Scaling
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import read
from animarl_envs.importing.tracks import Tracks
from animarl_envs.worlds import demonstration_observations
from tools.fuzz.layouts import write_agents, write_long, write_native, write_slp


def test_import_writes_demonstrations_and_a_recipe_that_repeats_them(tmp_path: Path) -> None:
    table, out = write_long(tmp_path), tmp_path / "out" / "demos.npz"
    animarl(
        "import", table, "--fps", 20, "--target", "female", "--decision-rate", 10,
        "--individuals", "male=he,female=female", "--arena", "square", "--out", out,
    )  # fmt: skip
    demos = Demonstrations.load(out)
    assert demos.individuals == ("he", "female") and demos.dt == pytest.approx(0.1)
    assert demos.roles == ("pursuer", "target")
    again = tmp_path / "again.npz"
    animarl("import", table, "--recipe", tmp_path / "out" / "demos.recipe.yaml", "--out", again)
    assert Demonstrations.load(again).fingerprint() == demos.fingerprint()


def test_import_says_where_a_stated_rate_is_not_that_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    rows = [f"{t / 25},{x},{x + t / 10},{t / 5}\n" for t in range(99) for x in (0, 5)]
    path.write_text("time,id,x,y\n" + "".join(rows))
    with pytest.warns(UserWarning, match="t: its file says 25 frames a second, taken are the 30"):
        assert read(path, frame_rate=30.0).dt == pytest.approx(1 / 30)
    with warnings.catch_warnings(action="error"):
        assert read(path, frame_rate=25.02).dt == pytest.approx(1 / 25.02)


def test_dry_import_says_what_it_understood_and_writes_nothing(tmp_path: Path) -> None:
    clip = write_slp(tmp_path)
    before = sorted(tmp_path.iterdir())
    said = animarl(
        "import", clip, "--source", "sleap", "--fps", 25, "--target", "none", "--dry-run"
    )
    assert "male, female" in said and "nothing was written" in said
    assert "head, thorax; used: centroid" in " ".join(said.split())
    assert sorted(tmp_path.iterdir()) == before


def test_sessions_of_one_name_are_told_apart_and_animals_of_one_put_together(
    tmp_path: Path,
) -> None:
    files = []
    for name in ("s1", "s2"):
        (tmp_path / name).mkdir()
        files.append(write_long(tmp_path / name))
    words = ("--fps", 20, "--target", "female", "--out", tmp_path / "demos.npz")
    animarl("import", *files, *words)
    stem = files[0].stem
    known = [f"s1/{stem}", f"s2/{stem}"]
    assert np.unique(Demonstrations.load(tmp_path / "demos.npz").recording).tolist() == known
    for rows in ("s1/NAME,0\ns2/NAME,1", "s1/NAME.csv,0\n/far/s2/NAME.csv,1"):
        table = tmp_path / "m.csv"
        table.write_text("recording,condition\n" + rows.replace("NAME", stem) + "\n")
        animarl("import", *files, *words, "--metadata", table)
        for one in Demonstrations.load(tmp_path / "demos.npz"):
            assert one.condition == known.index(one.recording)
    apart = []  # animals of one recording
    for name in ("male", "female"):
        apart.append(tmp_path / name / "r.csv")
        apart[-1].parent.mkdir()
        rows = "".join(f"{t},{name},{t},{len(name)}\n" for t in range(99))
        apart[-1].write_text("frame,id,x,y\n" + rows)
    animarl("import", *apart, "--fps", 20, "--out", tmp_path / "both.npz")
    demos = Demonstrations.load(tmp_path / "both.npz")
    assert demos.num_individuals == 2 and set(demos.recording) == {"r"}


def test_a_recording_that_is_given_twice_is_refused(tmp_path: Path) -> None:
    table = write_long(tmp_path)
    again, dry = tmp_path / ".." / tmp_path.name / table.name, ("--fps", 20, "--dry-run")
    refuses(f"{table.name}: it is given twice", animarl, "import", table, again, *dry)
    rows = table.read_text().splitlines()
    for name in ("mon.csv", "tue.csv"):
        lines = [f"{'recording' if i == 0 else 'r'},{row}" for i, row in enumerate(rows)]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
    days = [tmp_path / "mon.csv", tmp_path / "tue.csv"]
    words = r"mon\.csv and .*tue\.csv: both have .* of recording r:"
    refuses(words, animarl, "import", *days, *dry)


def test_options_without_effect_on_finished_demonstrations_are_refused(tmp_path: Path) -> None:
    native, out = write_native(tmp_path), tmp_path / "out.npz"
    words = ("--fps", 5, "--target", "male", "--keep-jumps", "--out", out)
    told = r"no effect on them \(--target, --fps, --keep-jumps\)"
    refuses(told, animarl, "import", native, *words)
    assert not out.exists()


def test_failed_imports_leave_nothing_behind(tmp_path: Path) -> None:
    table, out = write_long(tmp_path), tmp_path / "demos.npz"
    for words, message in (
        (("--out", out), "give it with --fps"),
        (("--fps", 20, "--out", tmp_path / "demos.txt"), "end in .npz"),
        (("--fps", 20), "name --out"),
        (("--fps", 20, "--target", "nobody", "--out", out), "no target 'nobody'"),
        (("--fps", 20, "--keypoint", "nose", "--out", out), "no keypoint 'nose'"),
        (("--fps", 20, "--option", "nonsense=1", "--out", out), "no option 'nonsense'"),
        (("--fps", 0, "--out", out), "frame_rate is 0.0: give a number above 0"),
        (("--fps", 20, "--decision-rate", 40, "--out", out), "no higher than that"),
        (("--fps", 20, "--farther-than", 1, "--out", out), "give both"),
        (("--fps", 20, "--species", "unicorn", "--out", out), "species 'unicorn' is unknown"),
        (("--fps", 20, "--split-seed", -1, "--out", out), "give zero or more"),
        (("--fps", 20, "--contact", "nan", "--out", out), "contact is nan: give a number of"),
        (("--fps", 20, "--arena", "triangle", "--out", out), "triangle"),
        (("--fps", 20, "--smoothing", -1, "--out", out), "smoothing_cutoff is -1.0: give"),
        (("--fps", 20, "--cut", "events", "--events", tmp_path / "no.csv", "--out", out), "no.csv"),
        (("--fps", 20, "--option", "unit={a: 1}", "--out", out), "give a name, such as mm"),
        (
            ("--fps", 20, "--individuals", "ghost", "--dry-run"),
            f"{table}: {table.stem}: there is no individual 'ghost'",
        ),
    ):
        refuses(message, animarl, "import", table, *words)
    assert not out.exists() and not list(tmp_path.glob(".demos*"))
    refuses("tracks: there is no recording in it", demonstrations_from_tracks, [], ImportRecipe())
    out.mkdir()
    (tmp_path / "file").write_text("a file")
    for place in (out, tmp_path / "file" / "demos.npz"):
        words = ("import", table, "--fps", 20, "--out", place)
        refuses("it is a folder|cannot be written", animarl, *words)


def test_data_commands(tmp_path: Path) -> None:
    path = write_agents(tmp_path)
    demos = read(path)
    assert "predator_0 (pursuer)" in animarl("data", "show", path)
    assert "3 episodes, all valid" in animarl("data", "check", path, "--out", tmp_path / "t.csv")
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    assert [float(row["duration"]) for row in rows] == pytest.approx([0.5, 0.3, 0.9])
    step = np.linalg.norm(np.diff(demos.episode(0).positions[:, 2], axis=0), axis=1)
    assert float(rows[0]["path_length_prey"]) == pytest.approx(step.sum())
    animarl("data", "split", path, "--by", "episode", "--seed", 1, "--out", tmp_path / "s.npz")
    assert {*Demonstrations.load(tmp_path / "s.npz").split} == {"train", "val", "test"}
    animarl("data", "plot", path, "--out", tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    animarl("data", "convert", path, "--out", tmp_path / "minari-v0")
    back = read(tmp_path / "minari-v0" / "data" / "main_data.hdf5")
    assert back.fingerprint() == demos.fingerprint()
    animarl("data", "convert", path, "--out", tmp_path / "table.csv")
    first = next(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    assert float(first["x"]) == demos.positions[0, 0, 0]
    assert "long-table" in animarl("data", "sources")


def test_fit_command_saves_what_it_prints(tmp_path: Path) -> None:
    path = write_native(tmp_path)
    out = tmp_path / "fit.csv"
    said = animarl("fit", path, "--split", "all", "--bootstrap", 20, "--out", out)
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["individual"] for row in rows] == ["male", "female"]
    assert f"{float(rows[0]['d']):.3f}" in said
    refuses(r"a table ends in \.csv", animarl, "fit", path, "--out", tmp_path / "fit.txt")


def test_import_takes_jumps_out_and_check_names_them(tmp_path: Path) -> None:
    t = np.arange(400)
    male = np.stack([np.cos(t / 40) + 30.0 * (t == 150), np.sin(t / 40)], axis=1)
    female = np.stack([np.full(400, 0.1), t / 400], axis=1)
    pair = write_tracks(tmp_path / "pair.csv", np.stack([male, female], 1), ("male", "female"))
    words = ("--fps", 20, "--target", "female", "--arena-width", 80)
    out = tmp_path / "kept.npz"
    said = animarl("import", pair, *words, "--out", out)
    named = "2 jumps and 0 swaps of identities flagged in 1 recording, first male at 7.5 s of pair"
    assert f"hint: {named}" in said and "2 jumps" in said
    assert f"check: {named}" in animarl("data", "check", out)
    dropped = tmp_path / "dropped.npz"
    said = animarl("import", pair, *words, "--drop-jumps", "--max-gap", 0.2, "--out", dropped)
    assert "flagged in" not in said  # nothing is left of jumps; of a swap it would be said
    recipe = ImportRecipe.load(tmp_path / "dropped.recipe.yaml")
    assert recipe.cleaning.drop_jumps and recipe.cleaning.max_gap == 0.2
    assert np.ptp(Demonstrations.load(out).positions[:, 0, 0]) > 0.7
    assert np.ptp(Demonstrations.load(dropped).positions[:, 0, 0]) < 0.1


def chase(folder: Path, recordings: int = 6, **columns: str) -> Path:
    """A table of prey that run from a predator, with further columns of one word each."""
    t, lines = np.arange(120) / 30, [",".join(["trial", "frame", "id", "x", "y", *columns])]
    for number in range(recordings):
        for name, x in (("prey", 2 + np.sin(t + number)), ("fox", np.sin(t + number - 0.3))):
            rows = enumerate(zip(x, np.cos(t + number), strict=True))
            more = "".join(f",{word}" for word in columns.values())
            lines += [f"T{number},{frame},{name},{a:.4f},{b:.4f}{more}" for frame, (a, b) in rows]
    (folder / "chase.csv").write_text("\n".join(lines) + "\n")
    return folder / "chase.csv"


def test_an_import_says_what_it_guessed_and_what_it_did_not_use(tmp_path: Path) -> None:
    table = chase(tmp_path, target="light", likelihood="0.9")
    words = ("import", table, "--fps", 30, "--dry-run")
    said = animarl(*words)
    assert "y is taken to grow upwards" in said and "since it is approached most, by" in said
    assert "not used: target (target belongs in a --metadata table)" in said
    assert "of a likelihood below" not in said
    assert "y is taken" not in animarl(*words, "--option", "y_down=true")
    assert "y is taken" not in animarl(*words, "--option", "unit=mm")


@pytest.mark.parametrize(
    ("words", "conditions", "unused"),
    [
        (["sham", "drug"], ["sham", "drug"], False),
        (["0", "1"], ["0", "1"], False),
        (["sham", "sham"], None, False),
        (["sham", "drug", "light"], None, True),
        ([""], None, False),
        (["sham", ""], None, True),
    ],
)
def test_a_column_of_the_tracks_states_two_conditions(
    words: list[str], conditions: list[str] | None, unused: bool, tmp_path: Path
) -> None:
    lines = chase(tmp_path).read_text().splitlines()
    each = [words[int(line[1]) % len(words)] for line in lines[1:]]
    rows = [f"{line},{word}" for line, word in zip(lines[1:], each, strict=True)]
    for name, table in (("each", rows), ("changing", [*rows[:-1], lines[-1] + ",other"])):
        (tmp_path / f"{name}.csv").write_text("\n".join([lines[0] + ",Condition", *table]))
    out = tmp_path / "out.npz"
    said = animarl("import", tmp_path / "each.csv", "--fps", 30, "--out", out)
    demos = Demonstrations.load(out)
    assert demos.provenance.get("conditions") == conditions
    if conditions is not None:
        named = [conditions[one] for one in demos.condition]
        assert named == [words[int(one[1]) % len(words)] for one in demos.recording]
    assert ("not used: condition (two" in said) is unused
    said = animarl("import", tmp_path / "changing.csv", "--fps", 30, "--dry-run")
    assert "not used: condition (two" in said


def test_what_metadata_say_is_not_taken_for_guessed(tmp_path: Path) -> None:
    table, beside = chase(tmp_path), tmp_path / "m.csv"
    rows = [f"T{n},{'sham' if n % 2 else 'drug'},prey" for n in range(6)]
    beside.write_text("\n".join(["Trial,condition,target", *rows]) + "\n")
    words = ("import", table, "--fps", 30, "--metadata", beside)
    said = animarl(*words, "--out", tmp_path / "d.npz")
    assert "is taken for the target" not in said and "--split-seed" not in said
    assert "condition 1 (sham)" in said and "no episode of condition" not in said
    assert "condition 0 (drug)" in animarl("data", "show", tmp_path / "d.npz")
    beside.write_text(beside.read_text().replace("T3,sham", "T3,Sham"))
    refuses("'sham' and 'Sham' differ only in capitals or blanks", animarl, *words, "--dry-run")


def test_recordings_that_begin_within_contact_are_named(tmp_path: Path) -> None:
    words = ("import", chase(tmp_path), "--fps", 30, "--target", "prey", "--dry-run")
    refuses("begin within contact, 4 arena units of 2 px", animarl, *words, "--contact", 4)


def test_a_table_that_was_converted_knows_its_times(tmp_path: Path) -> None:
    newts = load_packaged("newt").select(episodes=np.arange(3))
    animarl("data", "convert", newts.save(tmp_path / "n.npz"), "--out", tmp_path / "newt.csv")
    animarl("import", tmp_path / "newt.csv", "--target", "none", "--out", tmp_path / "again.npz")
    assert Demonstrations.load(tmp_path / "again.npz").dt == pytest.approx(newts.dt)


@pytest.mark.parametrize("pursuers", [1, 3])
def test_imported_tracks_are_an_environment_at_once(pursuers: int, tmp_path: Path) -> None:
    names = [*(f"hunter_{i}" for i in range(pursuers)), "hare"]
    steps = np.random.default_rng(pursuers).normal(0, 0.02, (300, len(names), 2))
    walk = np.cumsum(steps, axis=0) + np.arange(len(names))[:, None]
    table, out = write_tracks(tmp_path / "t.csv", walk, names), tmp_path / "demos.npz"
    animarl("import", table, "--fps", 10, "--target", "hare", "--out", out)
    assert "hare" in animarl("fit", out, "--bootstrap", 0)
    env = gym.make("AnimaRL/Custom-v0", demos=str(out))
    first, _ = env.reset(seed=0)
    assert env.observation_space.contains(first)
    seen = env.step(0)[0]
    assert env.observation_space.contains(seen) and not np.array_equal(seen, first)


def test_data_split_by_group_keeps_groups_together(tmp_path: Path) -> None:
    lines = ["run,frame,id,x,y"]
    for run in range(12):
        for t in range(20):
            x = np.sin(t / 5 + run)
            lines += [
                f"day{run // 2}_{run},{t},a,{x},{t / 20}",
                f"day{run // 2}_{run},{t},b,{-x},0",
            ]
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    words = ("--source", "long-table", "--option", "recording=run", "--fps", 10, "--target", "b")
    out = tmp_path / "runs.npz"
    animarl("import", tmp_path / "runs.csv", *words, "--split-pattern", r"(day\d)", "--out", out)
    dealt = tmp_path / "dealt.npz"
    animarl(
        "data", "split", out, "--by", "group", "--pattern", r"(day\d)", "--seed", 5, "--out", dealt
    )
    for demos in (Demonstrations.load(out), Demonstrations.load(dealt)):
        day = np.array([name.split("_")[0] for name in demos.recording])
        assert set(demos.split.tolist()) == {"train", "val", "test"}
        assert all(len(np.unique(demos.split[day == one])) == 1 for one in np.unique(day))
    for more, message in (
        (("--by", "group"), "needs a pattern"),
        (("--by", "nonsense"), "by is 'nonsense': choose auto, recording"),
        (("--fractions", "0.5,0.2"), "add up to 1"),
        (("--fractions", "a,b,c"), "three numbers"),
        (("--by", "group", "--pattern", "("), "no regular expression"),
        (("--by", "group", "--pattern", "(night)"), "does not fit every recording"),
    ):
        refuses(message, animarl, "data", "split", out, *more, "--out", tmp_path / "never.npz")
    assert not (tmp_path / "never.npz").exists()


def test_packaged_sets_are_known_by_name_where_no_such_file_is(tmp_path: Path) -> None:
    said = animarl("data", "show", "agent")
    assert "SYNTHETIC" in said and "prey (target)" in said
    assert "predator_0" in animarl("fit", "agent", "--bootstrap", 0)
    refusal = "no such file, packaged are agent.* and published sets are termites"
    refuses(refusal, animarl, "data", "show", tmp_path / "absent.npz")


def test_exported_minari_folder_is_read_by_its_name(tmp_path: Path) -> None:
    native = write_native(tmp_path)
    animarl("data", "convert", native, "--out", tmp_path / "set-v0")
    animarl("data", "convert", tmp_path / "set-v0", "--out", tmp_path / "back.npz")
    again = Demonstrations.load(tmp_path / "back.npz")
    assert again.fingerprint() == Demonstrations.load(native).fingerprint()
    told = "suffix says the format"
    refuses(told, animarl, "data", "convert", native, "--out", tmp_path / "demos.txt")
    refuses(r"ends in \.png", animarl, "data", "plot", native, "--out", tmp_path / "figure.txt")


def in_pixels(demos: Demonstrations) -> list[Tracks]:
    """Chases as a camera would give them: 25 px to a unit, the origin elsewhere."""
    return [
        Tracks(
            recording=f"r{one.index:02d}", individuals=demos.individuals,
            positions=25.0 * one.positions[:, :, None] + [425.0, -243.0],
            frame_rate=1 / demos.dt, outcome=one.outcome,
        )
        for one in demos
    ]  # fmt: skip


def test_inputs_of_networks_are_centred_and_scaled_in_any_unit(tmp_path: Path) -> None:
    scaling = Scaling(shape="open", centre=None)  # nobody said what an arena unit is
    recipe = ImportRecipe(target="prey", scaling=scaling)
    demos = demonstrations_from_tracks(in_pixels(few(test=3)), recipe)
    assert np.abs(demos.positions).max() <= 1.0 + 1e-9
    run = made(tmp_path, "soft-bc", demos=demos, species="custom", rolled_out=False)
    species = run.species
    model = run.learner("soft-bc", run.environment(demos))
    run.load_policy("soft-bc", model)
    train = demos.select(split="train")
    raw = demonstration_observations(species, train)
    network = model.policy.q_net
    mean, sd = (each[..., : raw.shape[-1]] for each in (network.input_mean, network.input_sd))
    seen = (torch.as_tensor(raw).transpose(0, 1) - mean) / sd  # without the condition's flag
    moving = seen.std(dim=1) > 1e-3
    assert moving.float().mean() > 0.9
    assert seen.mean(dim=1).abs().max() < 1.0  # mirrored chases count as well
    assert seen.std(dim=1)[moving].min() > 0.2
    assert 0.5 < float(seen.std(dim=1)[moving].median()) < 1.5
