"""Which channels of a cut hear the structure vibrate, what is left out, and a reader of them in one unit."""

from typing import NamedTuple

import numpy as np

from millcal.data import Recording
from millcal.errors import RecordingError
from millcal.numerics.revolutions import Samples, Survey
from millcal.numerics.spectra import Reader
from millcal.stages.conditioning.forces import Note

DERIVATIVES = {"acceleration": 0, "velocity": 1, "displacement": 2}  # to the acceleration
PATH = "path"  # dof of a channel that says where the tool is on its path


class Sensors(NamedTuple):
    """Channels that hear the structure vibrate."""

    rows: list[int]
    names: tuple[str, ...]
    dofs: tuple[str, ...]  # without sign
    signs: np.ndarray  # (sensor,) -1 for one that counts backwards
    powers: np.ndarray  # (sensor,) how often it is to be differentiated

    def reader(
        self,
        recording: Recording,
        scale: float,
        level: np.ndarray | float = 0.0,
        drift: np.ndarray | float = 0.0,
        size: np.ndarray | float = 1.0,
    ) -> Reader:
        """A reader of the vibrations less level + drift n, as accelerations if all were at one angular frequency.

        scale : that frequency, rad/s   level : (sensor,) m/s^2   drift : (sensor,) m/s^2 per sample
        size : (sensor,) m/s^2, what is read as 1
        """
        rows, gain = self.rows, (self.signs * scale**self.powers / size)[:, np.newaxis]
        slope = np.broadcast_to(drift / np.asarray(size), len(rows))[:, np.newaxis]
        origin = np.broadcast_to(level / np.asarray(size), len(rows))[:, np.newaxis]

        def read(start: int, stop: int) -> np.ndarray:
            samples = np.asarray(recording.block(start, stop, rows)) * gain
            if np.any(origin) or np.any(slope):
                samples -= slope * np.arange(start, stop) + origin
            return samples

        return read

    def without(self, left_out: np.ndarray) -> "Sensors":
        """The other sensors.   left_out : (sensor,) bool"""
        kept = np.flatnonzero(~left_out)
        return Sensors(
            [self.rows[i] for i in kept],
            tuple(self.names[i] for i in kept),
            tuple(self.dofs[i] for i in kept),
            self.signs[kept],
            self.powers[kept],
        )


def vibration_sensors(recording: Recording, where: str, note: Note) -> Sensors:
    """The channels of acceleration, velocity or displacement with a dof of their own; of two with one dof, the first.

    An acceleration goes before a velocity, and that before a displacement.
    """
    rows = [
        row
        for row, channel in enumerate(recording.channels)
        if channel.quantity in DERIVATIVES and channel.dof.lstrip("+-") != PATH
    ]
    nameless = [recording.channels[row].name for row in rows if not recording.channels[row].dof.lstrip("+-")]
    rows = [row for row in rows if recording.channels[row].dof.lstrip("+-")]
    if not rows:
        have = ", ".join(f"{c.name} ({' '.join(filter(None, (c.quantity, c.dof)))})" for c in recording.channels)
        if nameless:
            raise RecordingError(
                f"{where}: no sensor says where it sits: {', '.join(nameless)}; give each a dof as in the impact test, "
                'as in a1 = "tipX"'
            )
        raise RecordingError(
            f"{where}: no channel of acceleration, velocity or displacement; it has {have or 'no channels'}. "
            "Record the cut with the sensors of the impact test, or correct the channels' quantities"
        )
    if nameless:
        note("no-dof", f"{', '.join(nameless)}: no dof says where it sits, left out; give it one as in the impact test")
    taken: dict[str, int] = {}
    for row in sorted(rows, key=lambda row: DERIVATIVES[recording.channels[row].quantity]):
        dof = recording.channels[row].dof.lstrip("+-")
        if dof in taken:
            first, other = recording.channels[taken[dof]].name, recording.channels[row].name
            note("same-dof", f"{first} and {other} both measure {dof}: {other} is left out; give each its own dof")
        else:
            taken[dof] = row
    rows = sorted(taken.values())
    channels = [recording.channels[row] for row in rows]
    return Sensors(
        rows,
        tuple(channel.name for channel in channels),
        tuple(channel.dof.lstrip("+-") for channel in channels),
        np.array([-1.0 if channel.dof.startswith("-") else 1.0 for channel in channels]),
        np.array([DERIVATIVES[channel.quantity] for channel in channels]),
    )


def silent(sensors: Sensors, survey: Survey, where: str, note: Note, within: Samples | None = None) -> np.ndarray:
    """Sensors that never change, or never give a number, in the record or within some samples; one must be left.

    returns (sensor,) bool
    """
    start, stop = within or (0, np.inf)
    inside = (survey.time >= start) & (survey.time < stop)
    if not inside.any():
        return np.zeros(len(sensors.rows), bool)
    low, high = survey.low[:, inside], survey.high[:, inside]
    nothing = np.isnan(low).all(axis=1)
    still = np.fmin.reduce(low, axis=1) == np.fmax.reduce(high, axis=1)
    if np.all(nothing | still):
        raise RecordingError(f"{where}: the vibrations never change; check the sensors and the channels' names")
    for name, dof, empty, dead in zip(sensors.names, sensors.dofs, nothing, still, strict=True):
        if empty or dead:
            what = "holds no number" if empty else "never changes" if within is None else "is dead during the cut"
            note("dead-channel", f"{name} ({dof}) {what}: left out; check its cable")
    return nothing | still
