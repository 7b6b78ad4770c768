"""An FRF to modes: how many, where, with which residues, and how well each is known. Nobody has to click.

The modes are fitted to all entries of the FRF at once, in the form that was measured and with what the records' ends took
away (`numerics.modal_basis`), so that neither a division by w^2 nor a decay cut short biases them. The steps are files:
`problem` makes a least-squares problem of an FRF, `search` finds how many modes of which kind, `possible` says which a
structure can have, `delays` whether a response comes late, `intervals` how well all is known, and `answer` puts it together.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from millcal.data import Frf, Modes, Notice
from millcal.errors import IllPosedError
from millcal.numerics.mode_fit import fit_poles
from millcal.physics.structure import DERIVATIVES, convert_frf
from millcal.stages.modes.answer import answer
from millcal.stages.modes.problem import lines_of, problem_of, stride_of
from millcal.stages.modes.search import REMAINDER, search, stabilisation_chart, thinning

Progress = Callable[[float, str], None]  # share done in 0..1, what is being done


def fit_modes(
    frf: Frf,
    *,
    band: tuple[float, float] | None = None,
    modes: int | None = None,
    near: Sequence[float] = (),
    remainder: int | None = None,
    complex_modes: bool | None = None,
    most: int = 12,
    progress: Progress | None = None,
) -> Modes:
    """Modes of a measured FRF with intervals.

    band : Hz, the usable one when None   modes : how many; None lets the data decide, up to `most`
    near : frequencies in Hz where modes are known to be; alone, they are all there are
    remainder : terms for the modes outside the band, 0 to 4; None takes three
    complex_modes : True or False where the user knows
    raises IllPosedError where the FRF is no response to a force, or holds no lines or no mode to fit
    """
    progress = progress or (lambda share, label: None)
    if frf.form not in DERIVATIVES:
        raise IllPosedError(f"modes: a {frf.form} is no response of a structure to a force; give an FRF of motion")
    lines = lines_of(frf, band)
    low, high = frf.frequency[lines[0]], frf.frequency[lines[-1]]
    for frequency in near:
        if not low <= frequency <= high:
            raise IllPosedError(f"modes: {frequency:g} Hz is outside of the band, {low:g} to {high:g} Hz; widen it")
    problem = problem_of(frf, lines[:: stride_of(frf)])
    progress(0.1, "seeds")
    poles = stabilisation_chart(problem)
    progress(0.3, "modes")
    every = thinning(problem, poles)
    found = search(
        problem_of(frf, problem.lines[::every]) if every > 1 else problem,
        poles,
        powers=(*REMAINDER, 4)[: len(REMAINDER) if remainder is None else remainder],
        count=modes,
        near=near,
        complex_modes=complex_modes,
        most=most,
    )
    if not len(found.fit.natural_frequency):
        raise IllPosedError(
            f"modes: none stands out of the noise between {low:g} and {high:g} Hz; look at the coherence, or say near "
            "which frequency one is"
        )
    progress(0.6, "last digits")
    problem = problem if found.delay is None else problem.turned(found.delay)
    fit = fit_poles(problem.channels, found.fit.natural_frequency, found.fit.damping_ratio, found.model)
    progress(0.8, "intervals")
    record = answer(frf, problem, lines, found._replace(fit=fit), poles)
    if modes is None and not len(near) and len(fit.natural_frequency) >= most:
        message = f"{most} modes, as many as were allowed, and there may be more; allow more (most), or narrow the band"
        record = replace(record, notices=(*record.notices, Notice("most-modes", message)))
    return record


def corrected_frf(frf: Frf, modes: Modes) -> Frf:
    """The FRF on the lines of the fit without what windows and the records' ends took away.

    Measured less modelled plus synthesised: noise and everything the modes do not describe stay as they are.
    """
    fit = modes.fit
    if fit is None:
        raise IllPosedError("modes: given by hand; only fitted ones can correct an FRF")
    lines = np.flatnonzero((frf.frequency >= fit.frequency[0]) & (frf.frequency <= fit.frequency[-1]))
    if len(lines) != len(fit.frequency) or not np.allclose(frf.frequency[lines], fit.frequency):
        raise IllPosedError("modes: fitted to another FRF; fit this one first")
    lost = convert_frf(fit.frequency, fit.synthesised - fit.modelled, fit.form, frf.form)
    values = frf.values[lines] + lost

    def of_lines(array: np.ndarray | None) -> np.ndarray | None:
        return None if array is None else array[lines]

    return replace(
        frf,
        frequency=frf.frequency[lines],
        values=values,
        coherence=of_lines(frf.coherence),
        multiple_coherence=of_lines(frf.multiple_coherence),
        variance=of_lines(frf.variance),
        force_spectrum=of_lines(frf.force_spectrum),
        damping_shift=0.0,
        tests=(),
        notices=(
            *frf.notices,
            Notice("truncation-corrected", "what the records' ends took away is put back", level="note"),
        ),
    )
