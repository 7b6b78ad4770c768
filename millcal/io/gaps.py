"""Missing cells: a short gap is bridged by a straight line and told; a long one, or a dead channel, is an error.

A blank cell, NaN and an infinity all mean that there is no sample. The numbers pass by in blocks, so rows are held back
while a gap is open at the end of a block.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError

LONGEST = 20  # samples; a longer gap is no glitch
MOST = 0.01  # share of a channel's samples


def bridged(
    blocks: Iterable[np.ndarray],
    names: Sequence[str],
    path: object,
    place: Callable[[int], str],
    notices: list[Notice],
) -> Iterator[np.ndarray]:
    """The same blocks without missing cells; what was bridged is added to `notices` in the end.

    blocks : (column, n) each   place : row -> where it stands in the file
    """
    count = np.zeros(len(names), dtype=int)
    first = np.full(len(names), -1)
    held = np.empty((len(names), 0))  # at most LONGEST + 1 rows before an open gap, the gap included
    before = None  # the last row that went out
    rows = 0
    for new in blocks:
        block = np.concatenate([held, new], axis=1) if held.shape[1] else new
        gap = ~np.isfinite(block)
        if not gap.any():
            held = np.empty((len(names), 0))
            yield block
            before, rows = block[:, -1:], rows + block.shape[1]
            continue
        end = _complete_rows(gap)
        _check(gap, names, path, place, rows)
        held = block[:, end:].copy()
        if end:
            ready = _filled(block[:, :end], before, count, first, rows)
            yield ready
            before, rows = ready[:, -1:], rows + end
    if held.shape[1]:
        yield _filled(held, before, count, first, rows)
        rows += held.shape[1]
    for name, n, at in zip(names, count, first, strict=True):
        if n > MOST * rows:
            raise RecordingError(
                f"{path}: column '{name}' misses {n} of {rows} values, the first at {place(int(at))}; "
                "leave the column out with --map, or export the recording again"
            )
        if n:
            message = f"column '{name}': {n} missing values bridged by straight lines, the first at {place(int(at))}"
            notices.append(Notice("gaps-bridged", message, str(path)))


def _complete_rows(gap: np.ndarray) -> int:
    """How many rows have no gap that is open at the end."""
    whole = ~gap.any(axis=0)
    return gap.shape[1] if whole[-1] else int(np.flatnonzero(whole)[-1]) + 1 if whole.any() else 0


def _check(gap: np.ndarray, names: Sequence[str], path: object, place: Callable[[int], str], rows: int) -> None:
    """Refuse a gap of more than LONGEST samples."""
    for name, missing in zip(names, gap, strict=True):
        if not missing.any():
            continue
        edges = np.flatnonzero(np.diff(missing, prepend=False, append=False).astype(np.int8))
        starts, lengths = edges[::2], edges[1::2] - edges[::2]
        longest = int(np.argmax(lengths))
        if lengths[longest] <= LONGEST:
            continue
        begin = place(rows + int(starts[longest]))
        if missing.all() and rows == 0:
            what = f"column '{name}' holds no numbers"
        elif starts[longest] + lengths[longest] == gap.shape[1]:
            what = f"column '{name}' has no values from {begin} on for {lengths[longest]} rows or more"
        else:
            what = f"column '{name}' misses {lengths[longest]} values in a row from {begin}"
        raise RecordingError(f"{path}: {what}; leave the column out with --map, or export the recording again")


def _filled(
    block: np.ndarray, before: np.ndarray | None, count: np.ndarray, first: np.ndarray, rows: int
) -> np.ndarray:
    """Gaps bridged from the row before them to the row after; at the ends of the recording the nearest value stands."""
    block = block.copy()
    for column, values in enumerate(block):
        missing = ~np.isfinite(values)
        if not missing.any():
            continue
        where = np.flatnonzero(missing)
        count[column] += len(where)
        first[column] = rows + where[0] if first[column] < 0 else first[column]
        known = np.flatnonzero(~missing)
        at, value = known.astype(float), values[known]
        if before is not None:
            at, value = np.concatenate([[-1.0], at]), np.concatenate([before[column], value])
        values[where] = np.interp(where, at, value) if len(at) else 0.0
    return block
