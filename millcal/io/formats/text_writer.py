"""Text files of recordings: as a dynamometer's software exports them, and as plain columns with a row of units."""

from itertools import chain
from pathlib import Path

import numpy as np

from millcal.data import Recording
from millcal.io.results import write_text_atomically


def write_dynoware(path: Path, recording: Recording, *, measuring_time: float | None = None) -> None:
    """Write a DynoWare export: twenty header lines `key:,value`, names, units, rows from the recording's start time.

    measuring_time : s, which the header gives for the whole measurement; the file may hold a part of it, as exports do
    """
    rows = recording.samples.shape[1]
    total = rows / recording.sample_rate if measuring_time is None else measuring_time
    promised = rows if measuring_time is None else round(total * recording.sample_rate) + 1
    stem = Path(path).stem
    header = [
        "DynoWare,Version 2.5.1.2",
        "Path:,",
        f"Filename:,{stem}.dwd",
        f"Config ID:,{stem}.cfg",
        "Setup ID:,0",
        "Manipulated:,0",
        "Filename 1:, ",
        "Filename 2:, ",
        "Date:, ",
        "Time:, ",
        f"Sampling rate [Hz]:,{recording.sample_rate:.9g}",
        f"Measuring time [s]:,{total:.9g}",
        "Delay time [s]:,0",
        "Cycle time [s]:,0",
        "Cycles:,1",
        f"Samples per channel:,{promised}",
        "Cycle interval:,0",
        "Cycle No:,1",
    ]
    write_text_atomically(path, "\n".join(chain(header, _columns(recording))) + "\n")


def write_csv(path: Path, recording: Recording) -> None:
    """Write plain comma-separated columns under a row of names and a row of units."""
    write_text_atomically(path, "\n".join(_columns(recording)) + "\n")


def _columns(recording: Recording) -> list[str]:
    """Names, units, then a row per sample: time to nine digits, values to six."""
    samples = recording.block(0, recording.samples.shape[1])
    time = recording.start_time + np.arange(samples.shape[1]) / recording.sample_rate
    form = ",".join(["%.9g"] + ["%.6g"] * len(samples))
    rows = np.vstack([time, samples + 0.0]).T.tolist()  # + 0.0 turns -0 into 0
    names = ",".join(["Time", *(channel.name for channel in recording.channels)])
    units = ",".join(["s", *(channel.unit for channel in recording.channels)])
    return [names, units, *(form % tuple(row) for row in rows)]
