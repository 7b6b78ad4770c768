"""Reading a long text recording: millcal's reader beside a bare loop over `pandas.read_csv(chunksize)`."""

import sys
import tempfile
from pathlib import Path
from statistics import median

import numpy as np
from measure import spread, table, take_turns

SAMPLE_RATE = 51200  # Hz
SEED = 1

PLAIN = """
import pandas as pd
def read(path):
    return sum(len(chunk.to_numpy()) for chunk in pd.read_csv(path, chunksize=250_000))
"""

MILLCAL = """
from millcal.io.recordings import read_recording
def read(path):
    return sum(block.shape[1] for _, block in read_recording(path).blocks())
"""

TIMED = """
import sys, time
read(sys.argv[1])  # a short file, for what is imported on the way
start = time.process_time()
rows = read(sys.argv[2])
print(rows, time.process_time() - start)
"""


def write_text(path: Path, megabytes: int) -> None:
    """Three forces of a noisy cut with a time column, in blocks of a second."""
    rng = np.random.default_rng(SEED)
    with path.open("w") as file:
        file.write("Time [s],Fx [N],Fy [N],Fz [N]\n")
        for second in range(10**6):
            time = second + np.arange(SAMPLE_RATE) / SAMPLE_RATE
            force = 150 * np.sin(2 * np.pi * 200 * time) + rng.normal(0, 5, (3, SAMPLE_RATE))
            rows = np.column_stack([time, *force]).ravel().tolist()
            file.write("%.7f,%.4f,%.4f,%.4f\n" * SAMPLE_RATE % tuple(rows))
            if file.tell() >= megabytes * 10**6:
                return


def text_reader(options) -> str:
    """Every sample once, from a cold process; a rate is rows per CPU second of reading, imports aside, with threads counted."""
    with tempfile.TemporaryDirectory() as folder:
        short, long = Path(folder) / "short.csv", Path(folder) / "long.csv"
        write_text(short, 1)
        write_text(long, options.size_mb)
        programs = {"pandas.read_csv(chunksize)": PLAIN, "millcal.io.recordings": MILLCAL}
        commands = {
            name: [sys.executable, "-c", code + TIMED, str(short), str(long)] for name, code in programs.items()
        }
        costs = take_turns(commands, options.repeats)
    rates, rows = {}, set()
    for name, runs in costs.items():
        answers = [cost.output.split() for cost in runs]
        rows |= {int(count) for count, _ in answers}
        rates[name] = [int(count) / float(seconds) / 1e6 for count, seconds in answers]
    (n_rows,) = rows  # both readers see every row
    plain, own = rates.values()
    lines = [(f"`{name}`", spread(rates[name]), f"{max(cost.peak for cost in costs[name]):.0f}") for name in programs]
    ratios = [mine / theirs for mine, theirs in zip(own, plain, strict=True)]
    return (
        f"{options.size_mb} MB of text, {n_rows} rows of 4 numbers.\n\n"
        + table(("reader", "Mrow per CPU s (least / median)", "peak MB"), *lines)
        + f"\n\nRate against pandas, run by run: {min(ratios):.0%} at least, {median(ratios):.0%} median."
    )
