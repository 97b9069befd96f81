"""One HTML file that simulates a run's animals in the browser: what is written into it.

The file works offline, without Python: worlds and networks are computed by ``page/engine.js``,
which a test compares with this package step by step. It holds the policy, the world, the test
starts, and what is measured of the recordings.
"""

import base64
import gzip
import html
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing, slow_speeds
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.whatif.absent import (
    ANGLE_OF_REMOVED,
    DISTANCE_FACTOR_OF_REMOVED,
    can_remove,
    farthest_pursuer,
)
from animarl_algos.whatif.answer import TrainedRun
from animarl_algos.whatif.extrapolation import InputRange
from animarl_algos.whatif.quantities import (
    ALL,
    measured_quantities,
    quantities_of,
    resolve_measures,
)
from animarl_envs.cells import CellLocomotion
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import stand_in_note, unit_of
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.focus import COURSE, FALLBACK, UPWIND, is_free
from animarl_envs.scenario import Scenario
from animarl_envs.species import ChaseSpecies, SearchSpecies, Species
from animarl_envs.worlds import observation_components
from animarl_envs.worlds.chase import layout as chase_layout
from animarl_envs.worlds.chase import senses as chase_senses
from animarl_envs.worlds.plume.plume import ModelPlume, as_plume, hit_table
from animarl_envs.worlds.search import kernels as search_kernels
from animarl_envs.worlds.search import layout as search_layout
from animarl_envs.worlds.search.world import SearchWorld

MOST_INDIVIDUALS = 60
MOST_BYTES = 5_000_000
MOST_STARTS = 60
PARTS = ("page.html", "page.css", "measures.js", "engine.js", "page.js")
SPECIES_FIELDS = (
    "name",
    "title",
    "world",
    "individuals",
    "roles",
    "bodies",
    "dt",
    "time_limit",
    "warmup",
    "contact_radius",
    "conditions",
    "condition_is_sensed",
)
NETWORK_FIELDS = ("sensed", "units", "depth", "recurrent", "skip", "previous_action")
CHASE_SENSES = ("first", "stride", "damping", "push", "own_velocity")
PLUME_FIELDS = ("rows", "columns", "source_row", "source_column")
SYNTHETIC = "These recordings are synthetic: they were generated, not recorded from animals."
ONE_OF_FOLDS = (
    "This page asks one simulator, that of the run. <code>animarl whatif</code> asks those of all "
    "{folds} folds, and with <code>--fold 1</code> this one alone."
)


def write_page(
    run: TrainedRun, file: str | Path, *, title: str | None = None, folds: int = 1
) -> Path:
    """Write the page of a run; nothing is left behind if it cannot be made.

    Of a run that was cross-validated in so many ``folds``, the page says that it asks one.

    Raises
    ------
    InputError
        If a page cannot carry the run: what it simulates in the browser is less than the package
        does.
    """
    file = Path(file)
    model = page_model(run)
    if title is not None:
        model["title"] = title
    note = "" if folds == 1 else f"<p>{ONE_OF_FOLDS.format(folds=folds)}</p>"
    page = _fill(model, stand_in_note(run.demos) or SYNTHETIC, note)
    size = len(page.encode())
    if size > MOST_BYTES:
        raise InputError(
            f"the page would have {size / 1e6:.1f} MB, more than {MOST_BYTES / 1e6:g}: train a "
            "smaller network (policy_kwargs: hidden) or use 'animarl whatif'"
        )
    with write_then_rename(file) as part:
        part.write_text(page, encoding="utf-8")
    return file


def page_model(run: TrainedRun) -> dict[str, Any]:
    """Return everything that ``engine.js`` needs, as plain data.

    Raises
    ------
    InputError
        If a page cannot carry the run.
    """
    scenario = run.scenario
    species, arena = scenario.species, scenario.species.arena
    for sentence in _unsupported(scenario):
        raise InputError(sentence)
    every = run.demos.select(split="test")
    test = every.select(episodes=np.arange(min(len(every), MOST_STARTS)))
    unit = unit_of(run.demos)
    ranges = InputRange.of(species, run.demos.select(split="train"))
    model: dict[str, Any] = {
        **{name: getattr(species, name) for name in SPECIES_FIELDS},
        "synthetic": run.demos.synthetic,
        "unit": asdict(unit),
        "arena": asdict(arena)
        | {"walled": arena.walled}
        | ({"boundary": None} if arena.shape == "open" else {}),
        "lone": isinstance(species, ChaseSpecies) and species.lone_pursuer,
        "free": is_free(species.roles),
        "absent": {
            "farthest": farthest_pursuer(run.demos.select(split="train")),
            "beyond": DISTANCE_FACTOR_OF_REMOVED,
            "aside": ANGLE_OF_REMOVED,
        }
        if can_remove(species)
        else None,
        "traits": None if species.traits is None else species.traits.table.tolist(),
        "told": run.has_condition_flag,
        "locomotion": [{"damping": m.damping, "thrust": m.thrust} for m in species.locomotion],
        "pushes": [m.action_vectors.tolist() for m in species.locomotion],
        "components": len(observation_components(species)),
        "network": _network(run),
        "acting": run.policy.policy.acting.to_json(),
        "ranges": {
            "low": _packed(np.nan_to_num(ranges.low, neginf=-1e30).astype(np.float64)),
            "high": _packed(np.nan_to_num(ranges.high, posinf=1e30).astype(np.float64)),
            "words": list(ranges.words),
            "others": list(ranges.others),
        },
        "starts": _starts(test, scenario) | {"of": len(every)},
        **_measured(every, len(test), run),
    }
    if isinstance(species, ChaseSpecies):
        return model | {"senses": _chase_senses(species)}
    assert isinstance(species, SearchSpecies)
    columns = {seen.name: int(seen) for seen in search_layout.SearchEntry}
    senses = search_kernels.senses_of(species)._asdict()
    plain = {name: v if isinstance(v, bool) else float(v) for name, v in senses.items()}
    return model | {"senses": {"columns": columns} | plain, "plume": _plume(species)}


def _unsupported(scenario: Scenario) -> Iterator[str]:
    """Yield what the browser's simulator does not have, in sentences."""
    species, instead = scenario.species, "use 'animarl whatif'"
    if len(species.individuals) > MOST_INDIVIDUALS:
        yield (
            f"{len(species.individuals)} individuals are more than the {MOST_INDIVIDUALS} that a "
            f"page can simulate: {instead}"
        )
    if any(driver != "action" for driver in scenario.drivers):
        yield (
            "only some individuals of this run learned and the others follow their recordings, "
            f"which a page does not carry: train all of them, or {instead}"
        )
    if scenario.observation_noise or scenario.observation_delay:
        yield f"the senses of this run are noisy or late, which a page does not simulate: {instead}"
    if isinstance(species.locomotion[0], CellLocomotion):
        yield (
            "the animals of this run move by cells of recorded velocities, which a page does not "
            f"simulate: train with --cloning recurrent, or {instead}"
        )
    if isinstance(species, ChaseSpecies) and species.has_headings:
        yield (
            "the individuals of this run have headings of their own, which a page does not "
            "simulate: train with --set 'env_kwargs={senses_heading: false, turning: null}', or "
            f"{instead}"
        )
    if isinstance(species, SearchSpecies):
        if species.traits is not None or species.senses_past:
            yield (
                "the searchers of this run differ by traits or observe their past, which a page "
                f"does not simulate: {instead}"
            )
        if not isinstance(as_plume(species.plume), ModelPlume):
            yield (
                "this run searches a plume of the user's own, which a page does not carry: "
                f"{instead}"
            )


def _packed(array: NDArray[Any]) -> dict[str, Any]:
    """Return an array as text: its bytes, compressed."""
    array = np.ascontiguousarray(array)
    if array.dtype == bool:
        array = array.astype(np.uint8)
    squeezed = gzip.compress(array.astype(array.dtype.newbyteorder("<")).tobytes(), 9, mtime=0)
    return {
        "dtype": f"{array.dtype.kind}{array.dtype.itemsize}",
        "shape": list(array.shape),
        "data": base64.b64encode(squeezed).decode(),
    }


def _network(run: TrainedRun) -> dict[str, Any]:
    """Return the networks of all individuals; the head's two streams are folded into one."""
    net = run.policy.policy.q_net

    def layer(weight: Any, bias: Any) -> dict[str, Any]:
        each = weight.detach().cpu().numpy().astype(np.float32)
        return {
            "weight": _packed(each[:1] if (each == each[:1]).all() else each),  # shared: once
            "bias": _packed(bias.detach().cpu().numpy().astype(np.float32)),
        }

    layers = {
        f"encoder_{number}": layer(one.weight, one.bias)
        for number, one in enumerate(net.encoder, start=1)
    }
    if net.gru is not None:
        layers["gru_input"] = layer(net.gru.weight_input, net.gru.bias_input)
        layers["gru_hidden"] = layer(net.gru.weight_hidden, net.gru.bias_hidden)
    weight, bias = net.dueling.combined()
    shape = (net.num_actions, net.num_quantiles)
    mean = [part.unflatten(-1, shape).mean(-1) for part in (weight, bias)]
    layers["head"] = layer(*mean)
    hidden = net.dueling.hidden
    if hidden is not None:
        layers["head_hidden"] = layer(hidden.weight, hidden.bias)
    first = hidden.weight if hidden is not None else weight
    limit = float(net.input_limit.max())
    return {
        "layers": layers,
        "size": net.input_mean.shape[-1],
        **{name: getattr(net, name) for name in NETWORK_FIELDS},
        "actions": net.num_actions,
        "flag_in_head": bool(net.flag_in_head),
        "gated": bool(net.gated),
        "head_inputs": first.shape[1],
        "head_units": 0 if hidden is None else hidden.weight.shape[2],
        "input_mean": _packed(net.input_mean.cpu().numpy()),
        "input_sd": _packed(net.input_sd.cpu().numpy()),
        "input_limit": limit if np.isfinite(limit) else None,
    }


def _starts(test: Demonstrations, scenario: Scenario) -> dict[str, Any]:
    """Return the first frames of the test recordings, those of the warm-up included."""
    species, frames = scenario.species, scenario.species.warmup + 1
    index = np.minimum(np.arange(frames), test.lengths[:, None] - 1) + test.offsets[:-1, None]
    acted = demonstrated_actions(test, species.locomotion).astype(np.int8)
    recording = np.unique(test.recording, return_inverse=True)[1]
    starts: dict[str, Any] = {
        "frames": frames,
        "recorded": test.lengths.tolist(),
        "position": _packed(test.positions[index].astype(np.float64)),
        "velocity": _packed(test.velocities()[index]),
        "actions": _packed(acted[index]) if frames > 1 else None,
        "condition": test.condition.tolist(),
        "recording": (np.arange(len(test)) if len(set(recording)) == 1 else recording).tolist(),
        "heading": None,
        "hits": None,
        "pattern": None,
        "phase": None,
    }
    if isinstance(species, SearchSpecies):
        world = SearchWorld(scenario, len(test))
        world.seed(np.arange(len(test)))
        world.reset(demo=np.arange(len(test)))
        hits, headings = test.odour_hits(), test.headings()
        if hits is not None:
            starts["hits"] = _packed(hits[index].astype(np.uint8))
        if headings is not None:
            starts["heading"] = _packed(headings[index].ravel())
        starts |= {"pattern": world.pattern.tolist(), "phase": world.phase.tolist()}
    return starts


def _measured(test: Demonstrations, count: int, run: TrainedRun) -> dict[str, Any]:
    """Return what is measured, and of the first recordings their values, and coarsely their paths.

    Parameters
    ----------
    test
        All test recordings, which thresholds and lags are taken from.
    count
        How many of them the page has.
    """
    species, unit = run.scenario.species, unit_of(run.demos)
    rollouts = Rollouts.from_demonstrations(test)
    prepared = Prepared(test, comparison_smoothing(test))
    usual = list(quantities_of(species, unit, species.individuals))
    keys = resolve_measures([ALL], test)
    judged = list(measured_quantities(test, unit, keys, prepared.smoothing))
    quantities, measured = [], {}
    for one in (*usual, *judged):
        values = one.values(rollouts)[:count]
        if np.isfinite(values).any():
            scale = unit.per_arena_unit if one.unit.startswith(unit.name) else 1.0
            described = {"name": one.name, "unit": one.unit, "kind": one.kind, "scale": scale}
            quantities.append(described)
            measured[one.name] = [round(v, 6) if np.isfinite(v) else None for v in values.tolist()]
    first = test.select(episodes=np.arange(count))
    paths = first.positions.astype(np.float32)
    recorded = {
        "measured": measured,
        "offsets": first.offsets.tolist(),
        "paths": _packed(paths) if paths.nbytes < MOST_BYTES / 5 else None,
    }
    measuring = _measuring(prepared, species)
    return {"quantities": quantities, "recorded": recorded, "measuring": measuring}


def _measuring(prepared: Prepared, species: Species) -> dict[str, Any]:
    """Return what the verdict's measures need of the recordings, for ``measures.js``."""
    test, grid = prepared.demos, prepared.demos.resolution()
    low, size = prepared.rectangle
    return {
        "smoothing": prepared.smoothing,
        "lags": list(prepared.lags),
        "rest": prepared.rest.tolist(),
        "slow": slow_speeds(prepared.recorded).tolist(),
        "otherwise": UPWIND if isinstance(species, SearchSpecies) else FALLBACK,
        "grid": grid and asdict(grid) | {"single": grid.single, "reach": grid.reach},
        "low": low.tolist(),
        "size": size.tolist(),
        "maps": _packed(prepared.maps_of_others[:, : 1 if test.is_group else None]),
    }


def _chase_senses(species: ChaseSpecies) -> dict[str, Any]:
    senses = chase_senses.senses_of(species, np.ones(species.num_individuals, dtype=bool))
    return {
        "columns": {seen.name: int(seen) for seen in chase_layout.ChaseGroup},
        **{name: getattr(senses, name).tolist() for name in CHASE_SENSES},
        "near": senses.near,
        "scales": list(senses.scales),
        "limit": senses.limit,
        "past": list(chase_layout.PAST[: (not species.free) * chase_layout.past_scales(species)]),
        "memory": senses.shares[:-1].tolist() if species.free else [],
        "delays": [float(senses.shares[-1])] * chase_layout.DELAYS if species.free else [],
        "on_course": chase_layout.MEMORY.index(COURSE),
    }


def _plume(species: SearchSpecies) -> dict[str, Any]:
    """Return the table of hits of the patterns of training and test, as the world orders them."""
    scale = species.metres_per_unit
    patterns = tuple(sorted({*species.train_plumes, *species.test_plumes}))
    table = hit_table(as_plume(species.plume), patterns, species.dt, species.antenna_radius * scale)
    return {
        "bits": _packed(table.bits),
        **{name: getattr(table, name) for name in PLUME_FIELDS},
        "cell": table.cell / scale,
    }


def _fill(model: Mapping[str, Any], origin: str, note: str) -> str:
    """Return the page: template, style, programs and data in one file."""
    folder = resources.files("animarl_algos.whatif") / "page"
    parts = {name: (folder / name).read_text(encoding="utf-8") for name in PARTS}
    data = json.dumps(model, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    texts = {
        "__TITLE__": html.escape(str(model["title"])),
        "__ORIGIN__": f"<p><strong>{html.escape(origin)}</strong></p>"
        if model["synthetic"]
        else "",
        "__FOLDS__": note,
        "__STYLE__": parts["page.css"],
        "__ENGINE__": parts["measures.js"] + parts["engine.js"],
        "__PAGE__": parts["page.js"],
        "__DATA__": data,
    }
    # In one pass: a title that is a mark stays text.
    return re.sub("|".join(texts), lambda mark: texts[mark[0]], parts["page.html"])
