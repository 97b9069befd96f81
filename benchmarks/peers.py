"""Speed of peers that do not install beside this project, each in an environment of its own.

    python -m venv /tmp/peers && /tmp/peers/bin/pip install torch==2.13.0
    /tmp/peers/bin/pip install vmas==1.5.2
    /tmp/peers/bin/python benchmarks/peers.py vmas [--seconds 3.0]

The script imports nothing of this project. It runs simple_tag with two adversaries, one good agent
and two landmarks, random actions, on one thread of the processor. A figure is the best of many
repeats of ten steps; the median stands beside it. Compare with ``benchmarks/worlds.py`` on the same
machine at the same time.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable

COPIES = (1, 64, 1024, 8192)
STEPS = 10  # of a repeat
ACTIONS = 5  # of simple_tag: none and four directions


def vmas(copies: int) -> Callable[[], None]:
    """Ten steps of VMAS simple_tag (torch), observations and rewards included."""
    import torch
    from vmas import make_env

    torch.set_num_threads(1)
    env = make_env(
        "simple_tag", num_envs=copies, device="cpu", continuous_actions=False, seed=0,
        num_good_agents=1, num_adversaries=2, num_landmarks=2,
    )  # fmt: skip
    env.reset()
    actions = [[torch.randint(ACTIONS, (copies,)) for _ in range(3)] for _ in range(STEPS)]

    def steps() -> None:
        for action in actions:
            env.step(action)

    return steps


def jaxmarl(copies: int) -> Callable[[], None]:
    """Ten steps of JaxMARL simple_tag (jit and vmap), in one compiled scan."""
    import jax
    from jaxmarl import make

    env = make("MPE_simple_tag_v3", num_adversaries=2, num_good_agents=1, num_obs=2)
    states = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), copies))[1]

    def one(carry, key):  # type: ignore[no-untyped-def]
        keys = jax.random.split(key, copies)
        actions = {
            agent: jax.random.randint(k, (copies,), 0, ACTIONS)
            for agent, k in zip(env.agents, jax.random.split(key, len(env.agents)), strict=True)
        }
        observations, states, rewards, _, _ = jax.vmap(env.step)(keys, carry, actions)
        return states, (observations, rewards)

    run = jax.jit(lambda states, key: jax.lax.scan(one, states, jax.random.split(key, STEPS)))
    key = jax.random.PRNGKey(1)

    def steps() -> None:
        jax.block_until_ready(run(states, key))

    return steps


PEERS = {"vmas": vmas, "jaxmarl": jaxmarl}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("peer", choices=sorted(PEERS))
    parser.add_argument("--seconds", type=float, default=3.0, help="time for each figure")
    asked = parser.parse_args()
    os.environ |= {
        "OMP_NUM_THREADS": "1",
        "JAX_PLATFORMS": "cpu",
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    }
    print(f"{'copies':>8} {'best':>14} {'median':>14}  env steps / s, {asked.peer} simple_tag")
    for copies in COPIES:
        steps = PEERS[asked.peer](copies)
        steps()
        took, until = [], time.perf_counter() + asked.seconds
        while len(took) < 3 or time.perf_counter() < until:
            start = time.perf_counter()
            steps()
            took.append(time.perf_counter() - start)
        done = copies * STEPS
        print(f"{copies:8d} {done / min(took):14,.0f} {done / statistics.median(took):14,.0f}")


if __name__ == "__main__":
    main()
