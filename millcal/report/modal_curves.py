"""What is drawn of a modal fit, on the page and on paper: measured and fitted curves, what is left, the chart of poles."""

from dataclasses import dataclass

import numpy as np

from millcal.data import ModalFit, Modes
from millcal.report.charts import decades_of
from millcal.report.digits import fixed, significant
from millcal.report.driving_points import FORMS, PHASE_MIDDLE

UNDONE = 1e-3  # share of an FRF from which on it is said that the record took it away
BELOW = 0.2  # of the lowest natural frequency: further down an FRF shows little and takes half of a logarithmic scale
FAINTEST = 1e-5  # of the highest magnitude; what is left is not drawn further down


@dataclass(frozen=True, eq=False)
class FittedPair:
    """The curves of one response over one hammer, in the unit that the report shows."""

    frequency: np.ndarray  # (line,) Hz
    measured: np.ndarray  # (line,) magnitude
    fitted: np.ndarray  # (line,) of the structure itself
    as_recorded: np.ndarray  # (line,) of the structure, with what the record took away
    left: np.ndarray  # (line,) |measured - as recorded|
    measured_phase: np.ndarray  # (line,) deg
    fitted_phase: np.ndarray  # (line,) deg


def fitted_pair(modes: Modes, fit: ModalFit, output: int, given: int) -> FittedPair:
    """The curves of one pair of output and input over the lines of the fit, but for those far below all modes."""
    lines = lines_drawn(modes, fit)
    factor, middle = FORMS[fit.form][2], PHASE_MIDDLE[fit.form]
    turned = fit.outputs[output].startswith("-") != fit.inputs[given].startswith("-")
    middle_turn = np.exp(-1j * np.radians(middle)) * (-1 if turned else 1)
    measured, as_recorded, fitted = (v[lines, output, given] for v in (fit.measured, fit.modelled, fit.synthesised))
    return FittedPair(
        fit.frequency[lines],
        factor * np.abs(measured),
        factor * np.abs(fitted),
        factor * np.abs(as_recorded),
        factor * np.abs(measured - as_recorded),
        *(middle + np.degrees(np.angle(value * middle_turn)) for value in (measured, fitted)),
    )


def lines_drawn(modes: Modes, fit: ModalFit) -> np.ndarray:
    """Which lines of the fit are drawn: those not far below all modes; all, where that leaves none.   returns (line,)"""
    lines = fit.frequency >= BELOW * float(modes.natural_frequency.min())
    return lines if np.count_nonzero(lines) > 1 else np.ones(len(fit.frequency), bool)


def marks_drawn(modes: Modes, ends: tuple[float, float]) -> list[tuple[float, str]]:
    """Frequency and number of the modes within a range; one outside of the band has no place on its curves."""
    numbered = enumerate(modes.natural_frequency.tolist(), 1)
    return [(frequency, str(number)) for number, frequency in numbered if ends[0] <= frequency <= ends[1]]


def magnitudes_drawn(*pairs: FittedPair) -> tuple[float, float]:
    """Ends of an ordinate that holds the curves, and what is left down to where it counts."""
    low, high = decades_of(*(values for pair in pairs for values in (pair.measured, pair.fitted)))
    left = [float(np.median(pair.left[np.isfinite(pair.left)])) for pair in pairs if np.isfinite(pair.left).any()]
    return min([low, *(max(value / 2, FAINTEST * high) for value in left)]), high


def was_measured(fit: ModalFit, output: int, given: int) -> bool:
    """Whether there is an FRF of this pair."""
    return bool(np.isfinite(fit.measured[:, output, given]).any())


def driving_pairs(fit: ModalFit) -> list[tuple[int, int]]:
    """(output, input) of the driving points that were measured; the first pair at all where there is none."""
    pairs = [pair for pair in fit.driving_points.values() if was_measured(fit, *pair)]
    return pairs or [pair for pair in np.ndindex(len(fit.outputs), len(fit.inputs)) if was_measured(fit, *pair)][:1]


def cross_pairs(fit: ModalFit) -> list[tuple[int, int]]:
    """All others, first those between driving points."""
    driving = driving_pairs(fit)
    near = {output for output, _ in driving}
    pairs = [p for p in np.ndindex(len(fit.outputs), len(fit.inputs)) if p not in driving and was_measured(fit, *p)]
    return sorted(pairs, key=lambda pair: pair[0] not in near)


def taken_away(fit: ModalFit) -> float:
    """The share of the FRF that windows and the ends of the records took away, delays apart, and the fit puts back."""
    recorded = fit.modelled
    if fit.delay is not None:
        late = np.exp(2j * np.pi * np.outer(fit.frequency, np.nan_to_num(fit.delay)))
        recorded = recorded * late[:, :, np.newaxis]
    lost, all_of_it = (float(np.nansum(np.abs(v) ** 2)) for v in (fit.synthesised - recorded, recorded))
    return (lost / all_of_it) ** 0.5 if all_of_it else 0.0


def fitted_in_words(fit: ModalFit) -> str:
    """What a legend calls the fitted curve."""
    return "fitted, corrected" if fit.delay is not None or taken_away(fit) >= UNDONE else "fitted"


def mean_magnitude(fit: ModalFit) -> np.ndarray:
    """Root of the mean square over all FRFs that were measured: no mode is missing in it, whichever way it moves.

    returns (line,) in the unit that the report shows
    """
    there = [pair for pair in np.ndindex(fit.measured.shape[1:]) if was_measured(fit, *pair)]
    power = np.stack([np.abs(fit.measured[:, o, i]) ** 2 for o, i in there], axis=1)
    return FORMS[fit.form][2] * np.sqrt(np.mean(power, axis=1))


def mode_names(modes: Modes) -> list[str]:
    """1 to n, each with its frequency: what a mode is called beside the tables."""
    return [f"{number}: {significant(float(f), 4)} Hz" for number, f in enumerate(modes.natural_frequency, 1)]


def share(value: float) -> str:
    """A share in per cent, two digits, but not more exact than a hundredth of a per cent.

    >>> share(0.0256), share(0.00012), share(0.3), share(3e-7)
    ('2.6 %', '0.01 %', '30 %', '< 0.01 %')
    """
    if 0 < value < 5e-5:
        return "< 0.01 %"
    return f"{fixed(100 * value, 2 if value < 0.00995 else 1 if value < 0.0995 else 0)} %"
