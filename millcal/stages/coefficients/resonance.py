"""Would a resonance of the sensor explain what the law leaves? A diagnosis, never an answer.

Where harmonics above the tooth passing exceed the prediction and the asynchronous force shows lines, the law is fitted again
with one mode per axis of static gain 1 (frequency, damping and residue free) and a tapered runout, over all harmonics. How
well that predicts cuts it has not seen tells a resonance from a wrong law. Its coefficients are not offered: fitted modes
take up whatever is missing, and have been seen 20 % away from the lines of the records.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from millcal.data import AXES, Check, CutForce
from millcal.stages.coefficients.answer import Alternative, alternative
from millcal.stages.coefficients.average import NAMES
from millcal.stages.coefficients.harmonic import HarmonicStudy, parameters, search_near, study
from millcal.stages.coefficients.harmonic_model import HarmonicFit, refine, scan_phases


def lines_above(cuts: Sequence[CutForce], lowest: float) -> list[float]:
    """The two strongest groups of asynchronous lines above a frequency, Hz; lines within 8 % are one group."""
    groups: list[list[tuple[float, float]]] = []
    for peak in sorted((p for cut in cuts for p in cut.peaks if p.frequency > lowest), key=lambda p: -p.amplitude):
        home = next((g for g in groups if abs(peak.frequency - g[0][0]) < 0.08 * g[0][0]), None)
        if home is None:
            groups.append([(peak.frequency, peak.amplitude)])
        else:
            home.append((peak.frequency, peak.amplitude))
    return [group[0][0] for group in groups[:2]]


def diagnose(found: HarmonicStudy, saved: int) -> tuple[Check, Alternative] | None:
    """What one mode per axis would explain; None where the records show no line to start from."""
    best = found.best
    cuts = best.model.cuts
    lines = lines_above(cuts, 2 * best.model.cuts[0].cutter.teeth * max(cut.spindle_frequency for cut in cuts))
    if not lines or not found.left_out or best.model.sensor is not None or best.model.law != "linear-edge":
        return None
    first, second = lines[0], lines[-1]
    fits = []
    for modes in {(first, second, first), (second, first, second)}:
        model = replace(
            best.model, band=saved, mean_weight=1.0, taper=bool(best.model.runout_names), sensor_modes=modes
        )
        c0 = best.shape[: len(best.model.runout_names) - best.model.taper]
        taper = [-2 * float(np.linalg.norm(c0))] if model.taper else []
        sensor = np.concatenate([modes, [0.1] * 3, [1.0] * 3])
        start = HarmonicFit(model, np.array([*c0, *taper]), sensor, best.phase, best.linear, np.inf)
        fits.append(refine(replace(start, phase=scan_phases(start))))
    # a mode driven to the end of its range, 15 % from its line, is no longer the mode of that line
    near = [fit for fit in fits if np.all(np.abs(fit.sensor[:2] / fit.model.sensor_modes[:2] - 1) < 0.149)]
    chosen = min(near or fits, key=lambda fit: fit.cost)
    whole = study(chosen.model, search_near(chosen.model, chosen))
    assert whole.predicted is not None
    ratios = ", ".join(f"{axis} {value:.2f}" for axis, value in zip(AXES, whole.predicted, strict=True))
    modes = ", ".join(f"{value:.0f}" for value in whole.best.sensor[:3])
    explains = bool(np.all(whole.predicted <= 0.15))
    message = (
        f"one fitted mode per axis ({modes} Hz) and a tapered runout leave {ratios} of the AC force of cuts left out, over "
        f"{saved} harmonics: {'a resonance explains the excess; measure it' if explains else 'resonance alone is not the cause'}"
    )
    values = dict(zip((*NAMES, *whole.best.model.shape_names), parameters(whole.best), strict=True))
    return Check("resonance", explains, message), alternative("diagnosis with one mode per axis", values)
