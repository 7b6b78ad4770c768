"""How the tool meets the work along its path: depth, entry and exit angle, feed, from one place to the next.

Between two rows everything is straight; two rows at one place are a step. Feed directions turn the shorter way round.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class AlongPath(NamedTuple):
    """The engagement at some places."""

    axial_depth: np.ndarray  # m
    entry: np.ndarray  # rad
    leave: np.ndarray  # rad
    feed_direction: np.ndarray  # rad, from +x towards +y
    feed_per_tooth: np.ndarray | None  # m; None where the table says no feed
    feed_rate: np.ndarray | None  # m/s


@dataclass(frozen=True, eq=False)
class ToolPath:
    """An engagement table: one row for each place where something begins to change."""

    position: np.ndarray  # s, m along the path, not falling, (row,)
    axial_depth: np.ndarray  # m
    entry: np.ndarray  # rad, as in `cutter.engagement`
    leave: np.ndarray  # rad
    feed_direction: np.ndarray  # rad
    feed_per_tooth: np.ndarray | None = None  # m
    feed_rate: np.ndarray | None = None  # m/s
    name: str = ""  # file it came from, for messages

    @property
    def span(self) -> tuple[float, float]:
        """From, to, m."""
        return float(self.position[0]), float(self.position[-1])

    def at(self, position: np.ndarray) -> AlongPath:
        """The engagement at places within the span; at a step, that after it.   position : (place,) m"""
        segment = np.clip(np.searchsorted(self.position, position, "right") - 1, 0, len(self.position) - 2)
        length = self.position[segment + 1] - self.position[segment]
        share = (position - self.position[segment]) / np.where(length > 0, length, 1.0)
        share = np.where(length > 0, np.clip(share, 0.0, 1.0), 1.0)

        def along(column: np.ndarray | None) -> np.ndarray | None:
            return None if column is None else column[segment] + share * (column[segment + 1] - column[segment])

        depth, entry, leave = (along(column) for column in (self.axial_depth, self.entry, self.leave))
        direction = along(np.unwrap(self.feed_direction))
        return AlongPath(depth, entry, leave, direction, along(self.feed_per_tooth), along(self.feed_rate))  # type: ignore[arg-type]

    def position_after(self, time: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Where the tool is after a time on the path, with a feed rate that is straight between the rows.

        Exactly: v = v0 + g (s - s0) gives s - s0 = v0 (e^(g t) - 1) / g. Before the path and after it the feed goes on.
        time : (t,) s since the path began   speed : feed rate at the rows, (row,) m/s, above 0   returns (t,) m
        """
        length = np.diff(self.position)
        v0, v1 = speed[:-1], speed[1:]
        growth = np.log(v1 / v0)
        alike = np.abs(growth) < 1e-9
        mean = np.where(alike, (v0 + v1) / 2, (v1 - v0) / np.where(alike, 1.0, growth))  # over the time, not the way
        begin = np.concatenate([[0.0], np.cumsum(length / mean)])
        segment = np.clip(np.searchsorted(begin, time, "right") - 1, 0, len(length) - 1)
        since = time - begin[segment]
        whole = np.where(length > 0, length, 1.0)
        g = ((v1 - v0) / whole)[segment]
        turn = np.where(np.abs(g * since) < 1e-9, since, np.expm1(g * since) / np.where(g == 0, 1.0, g))
        inside = self.position[segment] + v0[segment] * turn
        after = self.position[-1] + speed[-1] * (time - begin[-1])
        return np.where(time < 0, self.position[0] + speed[0] * time, np.where(time > begin[-1], after, inside))
