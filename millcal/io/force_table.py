"""Harmonics of the cutting force as a table for other programs: CSV, a line for each harmonic of each cut.

`cut, k, spindle_harmonic, frequency_hz, Fx_re_N, Fx_im_N, Fx_amplitude_N, Fx_sd_N, ..., condition_number`, as the JSON has them:
re and im are those of numpy.fft.rfft(x) / n, amplitudes are peaks. What is not known is empty.
"""

import csv
from io import StringIO

from millcal.data import AXES, ForceHarmonics
from millcal.io.force_summary import summarise_forces

DIGITS = 10  # of every number: a round trip loses less than any sensor knows


def force_table(forces: ForceHarmonics) -> str:
    """The table as text, lines ended as RFC 4180 wants them."""
    axes = [axis for axis in AXES if axis in forces.axes]
    parts = [f"F{axis}_{part}_N" for axis in axes for part in ("re", "im", "amplitude", "sd")]
    text = StringIO()
    lines = csv.writer(text)
    lines.writerow(["cut", "k", "spindle_harmonic", "frequency_hz", *parts, "condition_number"])
    for line in summarise_forces(forces)["harmonics"]:
        values = [line["frequency_hz"]]
        for axis in axes:
            values += [*line[f"F{axis}_N"], line[f"F{axis}_amplitude_N"], line[f"F{axis}_sd_N"]]
        numbers = [_number(value) for value in (*values, line["condition_number"])]
        k = "" if line["k"] is None else line["k"]
        lines.writerow([line["cut"], k, line["spindle_harmonic"], *numbers])
    return text.getvalue()


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.{DIGITS}g}"
