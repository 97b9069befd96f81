"""How a trained policy should act: chosen by how likely its rollouts make what was recorded.

Candidates are Boltzmann sampling at temperature 1, which a clone's logits mean, and at shares of
the temperatures that fit the demonstrated actions best, and the greedy rule; where none of them
comes near, also sampling at one share for how hard and another for which way. Each is rolled out
from the starts of training and validation episodes, never of a test episode, and judged by the
likelihoods of the realism score (:mod:`animarl_algos.evaluation.realism`): motion, order in time,
reactions, place and endings, and the user's own measures where ``--choose-by`` names some. Rollouts
stop where their recording merely stops. They are made in rounds, with other random numbers each,
until two halves of the rounds choose the same.
"""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.collect import Cue, Policy, collect_rollouts
from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.realism import Likelihood
from animarl_algos.learner.progress import progress_display
from animarl_algos.networks.acting_rule import Acting
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.worlds.base import World

COOLER = (1.0, 0.85, 0.7, 0.5, 0.35)
"""Shares of the fitted temperatures that are tried: a clone that is unsure samples too widely."""
APART = tuple((thrust, way) for way in (0.7, 0.5, 0.35) for thrust in (0.7, 0.3))
"""Shares for how hard and for which way, of the fitted temperatures."""
MARGIN = 2.0
"""Standard errors over recordings by which another rule must beat the first, or a rule the best to
be rolled out again."""
MOST_STARTS, ROLLOUTS = 50, 400  # ROLLOUTS a round: scores need several from each start
MOST_ROUNDS = 6


@dataclass(frozen=True)
class Candidate:
    """An acting rule, and how likely its rollouts make the recordings.

    ``score`` is the mean log likelihood, ``kinds`` that of each kind of component; ``behind`` is by
    how many standard errors over recordings the score is below the best one, and ``rounds`` how
    often the rule was rolled out.
    """

    acting: str
    score: float
    kinds: Mapping[str, float]
    behind: float
    rounds: int


@dataclass(frozen=True)
class ActingChoice:
    """The rule that was chosen, and the candidates it was chosen from.

    ``others`` is the score of other recordings in place of rollouts, which a simulator that starts
    where the recording did should reach; ``short`` is by how many standard errors the chosen rule
    misses it. ``repeats``: two halves of the rounds chose the same.
    """

    acting: Acting
    candidates: tuple[Candidate, ...]
    others: float
    short: float
    repeats: bool

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self) | {"acting": self.acting.to_json()}


def candidate_rules(temperatures: ArrayLike) -> list[Acting]:
    """Return sampling at 1, at shares of the fitted ``temperatures`` ``(K,)``, and greedy."""
    fitted = np.atleast_1d(np.asarray(temperatures, dtype=np.float64))
    tried = [np.ones_like(fitted), *(fitted * share for share in COOLER)]
    return [*(Acting.boltzmann(temperature) for temperature in tried), Acting()]


def further_rules(temperatures: ArrayLike) -> list[Acting]:
    """Return rules that sample thrust and direction at different shares of ``temperatures``."""
    fitted = np.atleast_1d(np.asarray(temperatures, dtype=np.float64))
    return [Acting.boltzmann(fitted, thrust=hard, direction=way) for hard, way in APART]


def choice_episodes(demos: Demonstrations, seed: int) -> Demonstrations:
    """Return the episodes to choose by: validation, then training, up to ``MOST_STARTS``."""
    validation, training = (np.flatnonzero(demos.split == name) for name in ("val", "train"))
    rng = np.random.default_rng([seed, len(training)])
    spare = max(0, MOST_STARTS - len(validation))
    chosen = np.sort(np.concatenate([validation[:MOST_STARTS], rng.permutation(training)[:spare]]))
    if not len(chosen):
        raise InputError(
            f"{demos.name}: it holds no training or validation episode to choose an acting rule "
            "by: split it again"
        )
    return demos.select(episodes=chosen)


def choose_acting(
    policy_for: Callable[[Acting, int], Policy],
    make_world: Callable[[int], World],
    demos: Demonstrations,
    rules: Sequence[Acting],
    further: Sequence[Acting] = (),
    *,
    seed: int,
    cue: Cue | None = None,
    processes: int = 1,
) -> ActingChoice:
    """Return the acting rule under whose rollouts the recordings are likeliest.

    Parameters
    ----------
    policy_for
        The policy, acting by a rule, its draws seeded by a number.
    make_world
        Of the episodes ``demos``; see :func:`animarl_algos.evaluation.collect.collect_rollouts`.
    demos
        Training and validation episodes, see :func:`choice_episodes`.
    rules
        To choose among: the first of them, unless the best is better by more than ``MARGIN``
        standard errors; then the best. The others were fitted to few validation animals, and the
        best of a dozen is lucky.
    further
        To try as well where all ``rules`` fall short of other recordings.
    seed, cue
        Of the worlds, and what policies are told of the condition.
    processes
        Rules that are rolled out at once; the choice does not depend on it.
    """
    realism = Likelihood.of(Prepared(demos), own=[one for one in METRICS if one.chooses])
    repetitions = max(1, round(ROLLOUTS / demos.num_episodes))
    others = realism.of_others(repetitions, np.random.default_rng(seed))
    tried: dict[Acting, list[Floats]] = {rule: [] for rule in rules}
    behind, alive, number, repeats = dict[Acting, float](), list(rules), 0, False
    first = chosen = rules[0]

    def above(better: Floats, worse: Floats) -> float:
        return errors_above(realism.total(better) - realism.total(worse), demos.recording)

    def chosen_by(rounds: slice) -> Acting:
        """The best of these rounds; how far others are behind it stays in ``behind``."""
        means_by_rule = {rule: np.mean(tried[rule][rounds], axis=0) for rule in alive}
        best = max(alive, key=lambda rule: float(np.nanmean(realism.total(means_by_rule[rule]))))
        behind.update(
            {rule: above(means_by_rule[best], each) for rule, each in means_by_rule.items()}
        )
        return first if behind[first] <= MARGIN else best

    def roll_out(rule: Acting, own: int) -> Floats:
        """Return the log likelihoods of the recordings under a round of rollouts of a rule."""
        simulated = collect_rollouts(
            make_world,
            policy_for(rule, own),
            method="candidate",
            seed=own,
            repetitions=repetitions,
            cue=cue,
        )
        return realism.components(simulated)

    while number < MOST_ROUNDS and not repeats:
        own = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
        batches = [alive, list(further)] if number == 0 else [alive]
        title = f"choice of acting, round {number + 1} of at most {MOST_ROUNDS}"
        with progress_display(title, "rule", sum(map(len, batches))) as bar:
            for place, batch in enumerate(batches):
                if place and min(above(others, each[0]) for each in tried.values()) <= MARGIN:
                    break
                work = partial(roll_out, own=own)
                for rule, likely in zip(batch, on_cores(work, batch, processes)):
                    tried.setdefault(rule, []).append(likely)
                    bar.update()
        number, alive = number + 1, list(tried) if number == 0 else alive
        if number > 1:
            repeats = chosen_by(slice(0, None, 2)) == chosen_by(slice(1, None, 2))
        chosen = chosen_by(slice(None))
        alive = [rule for rule in alive if rule == first or behind[rule] <= MARGIN]
        repeats |= len(alive) == 1
    means = {rule: np.mean(each, axis=0) for rule, each in tried.items()}
    candidates = tuple(
        Candidate(
            str(rule),
            float(np.nanmean(realism.total(each))),
            realism.by_kind(each),
            behind[rule],
            len(tried[rule]),
        )
        for rule, each in means.items()
    )
    score = float(np.nanmean(realism.total(others)))
    return ActingChoice(chosen, candidates, score, above(others, means[chosen]), repeats)


def on_cores(
    work: Callable[[Acting], Floats], rules: Sequence[Acting], processes: int
) -> Iterator[Floats]:
    """Yield the work of each rule in their order, so many at once where processes can be forked.

    A trained learner cannot be sent to another process, but a fork of this one has it.
    """
    processes = min(processes, len(rules))
    if processes < 2 or "fork" not in multiprocessing.get_all_start_methods():
        yield from map(work, rules)
        return
    _forked.append(work)
    try:
        with multiprocessing.get_context("fork").Pool(processes, _obey_parent_alone) as pool:
            yield from pool.imap(_work_of, rules)
    finally:
        _forked.pop()


_forked: list[Callable[[Acting], Floats]] = []


def _obey_parent_alone() -> None:
    """Leave Ctrl-C to the parent, and end at once, without its words, when it says so."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _work_of(rule: Acting) -> Floats:
    return _forked[-1](rule)


def errors_above(difference: Floats, recording: NDArray[np.str_]) -> float:
    """Return the mean ``(starts,)`` in standard errors over recordings; 0 where there is one."""
    known = np.isfinite(difference)
    names, member = np.unique(recording[known], return_inverse=True)
    if len(names) < 2:
        return 0.0
    each = np.bincount(member, difference[known]) / np.bincount(member)
    error = each.std(ddof=1) / np.sqrt(len(each))
    return float(each.mean() / error) if error > 0 else 0.0
