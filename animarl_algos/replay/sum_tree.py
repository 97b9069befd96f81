"""Sum trees for proportional prioritised sampling (Schaul et al. 2016, appendix B.2.1).

K trees side by side, one per individual, in one array ``(K, 2 * leaves)``: the root is node 1, the
children of node i are 2 i and 2 i + 1, leaf ``j`` is node ``leaves + j``; ``leaves`` is a power of
two. A node is always the sum of its two children, computed afresh, so rounding never accumulates
and a tree rebuilt from its leaves is the same to the last bit.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_envs.compiling import jit
from animarl_envs.worlds.streams import next_uniform


@nb.njit(inline="always")
def set_leaf(trees, k, leaf, value):  # type: ignore[no-untyped-def]
    """Give leaf ``leaf`` of tree ``k`` the priority ``value``."""
    node = trees.shape[1] // 2 + leaf
    trees[k, node] = value
    while node > 1:
        node //= 2
        trees[k, node] = trees[k, 2 * node] + trees[k, 2 * node + 1]


@nb.njit(inline="always")
def find_leaf(trees, k, mass):  # type: ignore[no-untyped-def]
    """The leaf of tree ``k`` in whose share of the cumulative priority ``mass`` lies.

    A branch without priority is never entered, whatever the rounding of ``mass``.
    """
    leaves = trees.shape[1] // 2
    node = 1
    while node < leaves:
        node *= 2
        if mass >= trees[k, node] and trees[k, node + 1] > 0.0:
            mass -= trees[k, node]
            node += 1
    return node - leaves


@jit
def set_leaves(trees, k, leaves, values):  # type: ignore[no-untyped-def]
    """Give several leaves of tree ``k`` their priorities."""
    for i in range(len(leaves)):
        set_leaf(trees, k, leaves[i], values[i])


@jit
def draw_leaves(trees, streams, k, stratified, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` with leaves of tree ``k``, drawn in proportion to their priorities.

    Stratified: one draw from each of ``len(out)`` equal parts of the total priority; otherwise
    independent draws. Random numbers come from ``streams[k]``.
    """
    for b in range(len(out)):
        share = next_uniform(streams, k)
        if stratified:
            share = (b + share) / len(out)
        out[b] = find_leaf(trees, k, share * trees[k, 1])


class SumTrees:
    """K sum trees over ``capacity`` leaves each; ``nodes`` is the array that kernels work on.

    Priorities must be finite and not negative; a leaf of priority zero is never drawn.
    """

    def __init__(self, num_trees: int, capacity: int) -> None:
        self.capacity = capacity
        self.nodes: NDArray[np.float64] = np.zeros(
            (num_trees, self.num_nodes(capacity)), dtype=np.float64
        )

    @staticmethod
    def num_nodes(capacity: int) -> int:
        """Nodes of one tree: twice the next power of two; none for an empty one."""
        return 2 * max(2, 1 << (capacity - 1).bit_length()) if capacity else 0

    @property
    def priorities(self) -> NDArray[np.float64]:
        """Priorities of all leaves, ``(K, capacity)``, a view."""
        first = self.nodes.shape[1] // 2
        return self.nodes[:, first : first + self.capacity]

    @property
    def total(self) -> NDArray[np.float64]:
        """Sum of all priorities, ``(K,)``."""
        return self.nodes[:, 1]

    def set(self, k: int, leaves: ArrayLike, values: ArrayLike) -> None:
        """Give ``leaves`` of tree ``k`` the priorities ``values``."""
        set_leaves(
            self.nodes, k, np.asarray(leaves, dtype=np.int64), np.asarray(values, dtype=np.float64)
        )

    def draw(
        self, k: int, size: int, streams: NDArray[np.uint64], *, stratified: bool = True
    ) -> NDArray[np.int64]:
        """``size`` leaves of tree ``k``, in proportion to their priorities, from ``streams[k]``."""
        out = np.empty(size, dtype=np.int64)
        draw_leaves(self.nodes, streams, k, stratified, out)
        return out

    def restore(self, leaves: NDArray[np.int64], priorities: NDArray[np.float64]) -> None:
        """Make all trees anew: ``leaves`` get ``priorities`` ``(K, len(leaves))``, others zero."""
        half = self.nodes.shape[1] // 2
        self.nodes[:] = 0.0
        self.nodes[:, half + leaves] = priorities
        while half > 1:
            half //= 2
            below = self.nodes[:, 2 * half : 4 * half]
            self.nodes[:, half : 2 * half] = below[:, 0::2] + below[:, 1::2]
