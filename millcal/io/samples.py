"""Samples that may be too many for the memory: a scratch file that a stage reads block by block.

What is gathered is written to an unnamed temporary file as it comes; small recordings are read back into one array, and
large ones stay there until nobody holds them any more. A memory map would do the same, but its pages count as memory.
"""

import tempfile
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from millcal.data import SamplesOnDisk
from millcal.errors import RecordingError

IN_MEMORY = 100_000_000  # bytes of float64; larger recordings stay on disk
_SPOOL = 1 << 24  # bytes kept in memory before the scratch file is made


class Scratch:
    """Blocks of samples, appended once and then read anywhere."""

    def __init__(self, channels: int) -> None:
        self.shape = (channels, 0)
        self._starts: list[int] = []  # first sample of each block
        self._offsets: list[int] = []  # byte at which it begins
        self._size = 0
        self._file = tempfile.SpooledTemporaryFile(max_size=_SPOOL)  # noqa: SIM115  lives as long as the samples

    def append(self, block: np.ndarray) -> None:
        """Add the next samples.   block : (channel, n)"""
        data = np.ascontiguousarray(block, dtype=np.float64)
        try:
            self._file.write(data.data if data.size else b"")
        except OSError as problem:
            raise RecordingError(
                f"{tempfile.gettempdir()}: no room for {self._size + data.nbytes >> 20} MB of samples "
                f"({(problem.strerror or str(problem)).lower()}); set TMPDIR to a larger disk"
            ) from None
        self._starts.append(self.shape[1])
        self._offsets.append(self._size)
        self._size += data.nbytes
        self.shape = (self.shape[0], self.shape[1] + data.shape[1])

    def read_block(self, start: int, stop: int) -> np.ndarray:
        """Samples start..stop of all channels.   returns (channel, stop - start)"""
        start, stop, _ = slice(start, stop).indices(self.shape[1])
        result = np.empty((self.shape[0], max(stop - start, 0)))
        index = max(bisect_right(self._starts, start) - 1, 0)
        while start < stop:
            begin = self._starts[index]
            end = self._starts[index + 1] if index + 1 < len(self._starts) else self.shape[1]
            upto = min(stop, end)
            for row in range(self.shape[0]):
                self._file.seek(self._offsets[index] + 8 * (row * (end - begin) + start - begin))
                piece = np.frombuffer(self._file.read(8 * (upto - start)))
                result[row, result.shape[1] - (stop - start) :][: len(piece)] = piece
            start, index = upto, index + 1
        return result

    def settled(self) -> "np.ndarray | Scratch":
        """The samples in one array where they are few, else as they are, on disk."""
        return self.read_block(0, self.shape[1]) if self._size <= IN_MEMORY else self


class Chained:
    """Several recordings laid one behind the other."""

    def __init__(self, parts: Sequence[np.ndarray | SamplesOnDisk]) -> None:
        self.parts = tuple(parts)
        self._ends = np.cumsum([part.shape[1] for part in self.parts]).tolist()
        self.shape = (self.parts[0].shape[0], self._ends[-1])

    def read_block(self, start: int, stop: int) -> np.ndarray:
        """Samples start..stop of all channels.   returns (channel, stop - start)"""
        start, stop, _ = slice(start, stop).indices(self.shape[1])
        pieces = [np.empty((self.shape[0], 0))]
        for part, end in zip(self.parts, self._ends, strict=True):
            begin = end - part.shape[1]
            if start < end and stop > begin:
                pieces.append(block_of(part, max(start - begin, 0), min(stop, end) - begin))
        return np.concatenate(pieces, axis=1)


class Straightened:
    """Samples less a straight line per channel: offset + drift t."""

    def __init__(
        self, samples: np.ndarray | SamplesOnDisk, offset: np.ndarray, drift: np.ndarray, sample_rate: float
    ) -> None:
        self.samples, self.offset, self.drift, self.sample_rate = samples, offset, drift, sample_rate
        self.shape = samples.shape

    def read_block(self, start: int, stop: int) -> np.ndarray:
        """Samples start..stop of all channels.   returns (channel, stop - start)"""
        start, stop, _ = slice(start, stop).indices(self.shape[1])
        time = np.arange(start, stop) / self.sample_rate
        line = self.offset[:, np.newaxis] + self.drift[:, np.newaxis] * time
        return block_of(self.samples, start, stop) - line


def block_of(samples: np.ndarray | SamplesOnDisk, start: int, stop: int) -> np.ndarray:
    """A block from memory or from disk."""
    if isinstance(samples, np.ndarray):
        return samples[:, start:stop]
    return samples.read_block(start, stop)


def in_memory_if_small(samples: np.ndarray | SamplesOnDisk) -> np.ndarray | SamplesOnDisk:
    """One array where the samples are few, else as they are."""
    small = 8 * samples.shape[0] * samples.shape[1] <= IN_MEMORY
    return block_of(samples, 0, samples.shape[1]) if small else samples
