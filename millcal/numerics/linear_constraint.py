"""What a linear law y = M k demands of y whatever k is, and what y cannot say about k.

The columns of M may have different units, so they are scaled to unit length before the rank is judged. A column that is zero but
for rounding would be blown up into a false direction by that; such columns are taken out first.
"""

from typing import NamedTuple

import numpy as np

NEGLIGIBLE = 1e-10  # of the longest column
TOLERANCE = 1e-9  # of the largest singular value of the scaled columns


class ColumnSpace(NamedTuple):
    """The y that a law allows, the others, and the k that it does not show."""

    rank: int
    basis: np.ndarray  # Q, orthonormal, (m, rank)
    complement: np.ndarray  # orthonormal, (m, m - rank): its conjugate transpose times y is zero
    null: np.ndarray  # (n, n - rank), in the units of k: M times it is zero
    condition: float  # of the scaled columns, as far as the rank reaches
    scale: np.ndarray  # length of each column, (n,); 0 where it is negligible


def column_space(M: np.ndarray, tolerance: float = TOLERANCE) -> ColumnSpace:
    """The space of the columns of M.   M : (m, n), real or complex, any units by column"""
    M = np.asarray(M)
    m, n = M.shape
    length = np.linalg.norm(M, axis=0)
    kept = np.flatnonzero(length > NEGLIGIBLE * length.max(initial=0.0))
    scale = np.zeros(n)
    scale[kept] = length[kept]
    alone = np.eye(n, dtype=M.dtype)[:, scale == 0]
    if not len(kept):
        return ColumnSpace(0, np.zeros((m, 0), M.dtype), np.eye(m, dtype=M.dtype), alone, float("nan"), scale)
    U, s, Vh = np.linalg.svd(M[:, kept] / scale[kept])
    rank = int(np.count_nonzero(s > tolerance * s[0]))
    together = np.zeros((n, len(kept) - rank), M.dtype)
    together[kept] = Vh[rank:].conj().T / scale[kept, np.newaxis]
    return ColumnSpace(rank, U[:, :rank], U[:, rank:], np.hstack([alone, together]), float(s[0] / s[rank - 1]), scale)


def unobservable(space: ColumnSpace, *, least: float = 1e-6) -> list[tuple[int, ...]]:
    """Which parameters no row shows: alone, (i,), or only in combination, (i, j, ..).

    Parameters whose unseen combinations share a member stand in one tuple. Ambiguous is what the null space moves by more
    than `least` of a scaled column.
    """
    found: list[tuple[int, ...]] = [(int(i),) for i in np.flatnonzero(space.scale == 0)]
    kept = np.flatnonzero(space.scale)
    together = space.null[:, len(found) :][kept] * space.scale[kept, np.newaxis]  # orthonormal again
    projector = together @ together.conj().T
    moved = np.abs(projector) > least
    waiting = [int(i) for i in np.flatnonzero(np.diag(moved))]
    while waiting:
        group, reach = {waiting[0]}, [waiting[0]]
        while reach:
            ahead = [j for j in waiting if moved[reach[-1], j] and j not in group]
            reach.pop()
            group.update(ahead)
            reach.extend(ahead)
        found.append(tuple(int(kept[i]) for i in sorted(group)))
        waiting = [i for i in waiting if i not in group]
    return sorted(found)
