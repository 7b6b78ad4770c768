"""At which depths a cut is stable: from crossings of the unit circle to the edges of the stable set.

Stability can come back with growing depth: a flip lobe is an island that closes, and above it the cut is stable again up
to the next limit. So the answer at one speed is a set of depths, told by its edges in ascending order: at the first
stability is lost, at the second it is back, and so on. A depth is stable where an even number of edges lies at or below it.
"""

import numpy as np

from millcal.physics.stability.regeneration import HOPF, Crossings


def edges_of(crossings: Crossings, *, complete: bool = False) -> Crossings:
    """Those crossings at which the cut as a whole loses or regains stability, in the order of speed and depth.

    complete : the crossings are those of every multiplier, of which several may be outside at once: they are counted, a Hopf
    crossing as a pair. Else each says what the whole cut does, and those that change nothing are left out.
    """
    order = np.lexsort((crossings.depth, crossings.speed))
    crossings = Crossings(*(np.asarray(part)[order] for part in crossings))
    fresh = np.diff(crossings.speed, prepend=-1) != 0
    unstable = crossings.loses.astype(bool)
    if complete and len(fresh):
        change = np.where(crossings.kind == HOPF, 2, 1) * np.where(unstable, 1, -1)
        outside = np.cumsum(change)
        start = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
        unstable = outside > (outside - change)[start]
    was = np.where(fresh, False, np.concatenate([[False], unstable[:-1]])[: len(fresh)])
    turns = unstable != was
    return Crossings(*(part[turns] for part in crossings._replace(loses=unstable)))


def edge_table(edges: Crossings, speeds: int) -> np.ndarray:
    """The depths of `edges_of` side by side.   returns (speed, edge) m, inf behind the last; at least one edge wide"""
    fresh = np.diff(edges.speed, prepend=-1) != 0
    start = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
    place = np.arange(len(fresh)) - start
    table = np.full((speeds, 1 + int(place.max(initial=0))), np.inf)
    table[edges.speed, place] = edges.depth
    return table


def is_stable(table: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Whether depths are stable.   table : (..., edge) m   depth : (...,) m   returns bool (...,)"""
    return np.sum(table <= np.asarray(depth)[..., np.newaxis], axis=-1) % 2 == 0


def stable_share(table: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """The share of draws in whose stable set each depth lies.

    table : (member, speed, edge) m   depth : (depth,) m, ascending   returns (depth, speed)
    """
    members, speeds, edges = table.shape
    below = np.searchsorted(depth, table)  # the first depth that is not above the edge; equal counts as beyond
    at = np.arange(speeds)[:, np.newaxis] * (len(depth) + 1)
    sign = np.broadcast_to(np.where(np.arange(edges) % 2, 1.0, -1.0), table.shape)
    change = np.bincount((below + at).ravel(), sign.ravel(), speeds * (len(depth) + 1))
    return 1.0 + np.cumsum(change.reshape(speeds, -1)[:, :-1].T, axis=0) / members
