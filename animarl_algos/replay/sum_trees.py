"""Sum trees for proportional prioritised sampling (Schaul et al. 2016, appendix B.2.1).

K trees stand side by side, one per individual, in one array ``(K, 2 * leaves)``. The root is node
1, the children of node i are 2 i and 2 i + 1, leaf ``j`` is node ``leaves + j``; ``leaves`` is a
power of two. A node is always the sum of its two children, computed afresh, so rounding never
accumulates and a tree rebuilt from its leaves is the same to the last bit.
"""

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from animarl_envs.array_types import Floats, Ints
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
    """Return the leaf of tree ``k`` in whose share of the cumulative priority ``mass`` lies.

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
def _set_leaves(trees, leaves, values, exponent):  # type: ignore[no-untyped-def]
    for k in range(leaves.shape[0]):
        for b in range(leaves.shape[1]):
            if leaves[k, b] >= 0:
                set_leaf(trees, k, leaves[k, b], values[k, b] ** exponent)


@jit
def _find_leaves(trees, shares, leaves):  # type: ignore[no-untyped-def]
    for k in range(shares.shape[0]):
        for b in range(shares.shape[1]):
            leaves[k, b] = find_leaf(trees, k, shares[k, b] * trees[k, 1])


@jit
def draw_stratified(streams, shares):  # type: ignore[no-untyped-def]
    """Fill ``shares`` (K, B) with one number from each of B equal parts of [0, 1).

    Individual k draws by ``streams[k]``.
    """
    columns = shares.shape[1]
    for k in range(len(streams)):
        for b in range(columns):
            shares[k, b] = (b + next_uniform(streams, k)) / columns


class SumTrees:
    """K sum trees over ``capacity`` leaves each; ``nodes`` is the array of them all.

    Priorities must be finite and not negative; a leaf of priority zero is never drawn.
    """

    def __init__(self, num_trees: int, capacity: int) -> None:
        self.capacity = capacity
        # Of one tree twice the next power of two, and none of an empty one.
        nodes = 2 * max(2, 1 << (capacity - 1).bit_length()) if capacity else 0
        self.nodes: Floats = np.zeros((num_trees, nodes), dtype=np.float64)

    @property
    def priorities(self) -> Floats:
        """Priorities of all leaves, ``(K, capacity)``, a view."""
        first = self.nodes.shape[1] // 2
        return self.nodes[:, first : first + self.capacity]

    def set(self, leaves: ArrayLike, values: ArrayLike, exponent: float = 1.0) -> None:
        """Give ``leaves`` the priorities ``values ** exponent``; those below 0 are passed over.

        Both are ``(K, B)``, or broadcast to it.
        """
        shape = np.broadcast_shapes(np.shape(leaves), np.shape(values), (len(self.nodes), 1))
        places = np.broadcast_to(np.asarray(leaves, dtype=np.int64), shape)
        given = np.broadcast_to(np.asarray(values, dtype=np.float64), shape)
        _set_leaves(self.nodes, places.copy(), given.copy(), exponent)

    def find(self, shares: Floats) -> Ints:
        """Return the leaf in which each share (K, B) of its tree's total priority lies."""
        leaves = np.empty(shares.shape, dtype=np.int64)
        _find_leaves(self.nodes, shares, leaves)
        return leaves

    def restore(self, leaves: Ints, priorities: Floats) -> None:
        """Make all trees anew: ``leaves`` get ``priorities`` ``(K, len(leaves))``, others zero."""
        self.nodes[:] = 0.0
        self.set(leaves, priorities)
