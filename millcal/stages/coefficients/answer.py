"""The shape of an answer: what both methods keep for the report, beside coefficients and verdict."""

from collections.abc import Sequence

import numpy as np

from millcal.data import Check, Coefficients, CutForce, Notice, Posterior
from millcal.physics.cutting_force import force_at
from millcal.stages.coefficients.verdict import short_name

ANGLES = 360  # points of the curves that are kept for the report
NO_AIR_CUT = Notice(
    "no-air-cut", "no air cut in any record: the edge coefficients absorb the amplifier's offset", "cuts"
)

Alternative = tuple[str, tuple[tuple[str, float], ...]]


def alternative(name: str, values: dict[str, float]) -> Alternative:
    """Coefficients of another model, to show how far the answer moves with it.   values : name -> SI"""
    return name, tuple((key, float(value)) for key, value in values.items())


def answer(
    cuts: Sequence[CutForce],
    posterior: Posterior,
    verdict: str,
    checks: Sequence[Check],
    *,
    modelled: Sequence[np.ndarray],
    means: tuple[np.ndarray, np.ndarray],
    residual_rms: np.ndarray,
    r2: np.ndarray,
    alternatives: Sequence[Alternative],
    notices: Sequence[Notice],
    **more: np.ndarray | tuple[int, int] | None,
) -> Coefficients:
    """The record, with both force curves and both spectra.

    modelled : complex (axis, k) N for each cut   means : measured and modelled (cut, axis) N   more : fields of the record
    """
    angle = 2 * np.pi * np.arange(ANGLES) / ANGLES
    saved = min(cut.harmonics.shape[1] for cut in cuts)
    measured = np.stack([cut.harmonics[:, :saved] for cut in cuts])
    predicted = np.stack([value[:, :saved] for value in modelled])
    return Coefficients(
        posterior=posterior,
        cutter=cuts[0].cutter,
        conditions=tuple(cut.conditions for cut in cuts),
        cuts=tuple(short_name(cut) for cut in cuts),
        verdict=verdict,
        checks=tuple(checks),
        feed_per_tooth=np.array([cut.conditions.feed_per_tooth for cut in cuts]),
        measured_mean=means[0],
        modelled_mean=means[1],
        angle=angle,
        measured=force_at(measured, angle),
        modelled=force_at(predicted, angle),
        measured_amplitude=np.abs(measured),
        modelled_amplitude=np.abs(predicted),
        residual_rms=residual_rms,
        r2=r2,
        alternatives=tuple(alternatives),
        notices=tuple(dict.fromkeys(notices)),
        **more,  # type: ignore[arg-type]
    )
