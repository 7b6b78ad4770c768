"""Other programs on the impact tests: pyFRF, scipy and sdypy-EMA, called as an expert would who knows the truth.

They are handed what they cannot find themselves: hits cut out at their true onsets, the good ones named where that is
said, and the exact natural frequencies. sdypy-EMA's window of frequencies is narrowed to the distance of the modes, since
its default of 50 Hz makes it return one of two close modes twice.
"""

import contextlib
import io
import warnings
from typing import NamedTuple

import numpy as np
from impact_cases import RATE, Case
from impact_errors import frf_error, modal_errors

INSTALL = "pip install -c constraints.txt 'pyFRF==1.5.0' 'sdypy-EMA==0.31.0'"
BEFORE = 160  # samples before an onset where hits are cut out of a continuous recording
LENGTH = 8192
PULSE = 0.04 * LENGTH  # samples of the force window
ORDERS = (20, 40, 60)  # of sdypy-EMA's polynomials; 80 is no better on these kinds


def missing() -> str | None:
    """What is not installed, or None."""
    try:
        import pyFRF  # noqa: F401
        import sdypy.EMA  # noqa: F401
    except ImportError as error:
        return error.name
    return None


class Cut(NamedTuple):
    """The hits of one recording, pre-cut."""

    force: np.ndarray  # (hit, input, sample)
    response: np.ndarray  # (hit, output, sample)
    good: list[int]


def cut_hits(case: Case) -> list[Cut]:
    """Every hit of every recording in a record of its own."""
    cuts = []
    for recording, good in zip(case.recordings, case.good, strict=True):
        if recording.segments is None:
            starts, length = [round(onset * RATE) - BEFORE for onset in case.onset], LENGTH
        else:
            starts, length = [int(start) for start, _ in recording.segments], int(recording.segments[0, 1])
        samples = np.stack([recording.samples[:, start : start + length] for start in starts])
        m = len(recording.rows_of("force"))
        cuts.append(Cut(samples[:, :m], samples[:, m:], good))
    return cuts


class Estimate(NamedTuple):
    """An FRF of a peer, as receptance."""

    frequency: np.ndarray
    values: np.ndarray  # (frequency, output, input)

    def error(self, case: Case) -> float:
        return frf_error(case.structure, self.frequency, self.values, "receptance", *dofs(case))


def dofs(case: Case) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Outputs and inputs of the whole test."""
    names = [c.dof for recording in case.recordings for c in recording.channels if c.quantity == "force"]
    return case.structure.dofs, tuple(dict.fromkeys(names))


def pyfrf(cuts: list[Cut], window="none", *, expert: bool = False) -> Estimate:
    """pyFRF's H1.   expert : only the good hits, with the mean before the hit removed from every channel"""
    from pyFRF import FRF

    columns = []
    for cut in cuts:
        force, response = cut.force, cut.response
        if expert:
            force, response = (
                part[cut.good] - part[cut.good, :, : BEFORE - 20].mean(axis=2, keepdims=True)
                for part in (force, response)
            )
        frf = FRF(int(RATE), exc=force, resp=response, exc_type="f", resp_type="a", window=window)
        columns.append(np.moveaxis(frf.get_FRF(frf_form="receptance"), -1, 0))
    return Estimate(frf.get_f_axis(), np.concatenate(columns, axis=2))


def force_window(cuts: list[Cut]) -> tuple[str, str]:
    """pyFRF's force window, which starts with the record and is a share of it."""
    return (f"force:{PULSE / cuts[0].force.shape[2]}", "none")


def scipy_csd(cuts: list[Cut]) -> Estimate | None:
    """H1 of Welch's spectra, one segment a hit; None for several forces at once."""
    from scipy.signal import csd

    columns = []
    for cut in cuts:
        hits, m, n = cut.force.shape
        if m > 1:
            return None
        force = cut.force[:, 0].ravel()
        response = cut.response.transpose(1, 0, 2).reshape(-1, hits * n)
        how = {"fs": RATE, "window": "boxcar", "nperseg": n, "noverlap": 0, "detrend": False}
        frequency, cross = csd(force, response, **how)
        columns.append((cross / csd(force, force, **how)[1]).T[:, :, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.concatenate(columns, axis=2) / -((2 * np.pi * frequency) ** 2)[:, None, None]
    return Estimate(frequency, values)


def ema(case: Case, estimate: Estimate, form: str, orders=ORDERS):
    """sdypy-EMA's LSCF poles nearest to the true frequencies, and its LSFD constants with both residuals.

    Of the orders, the one whose FRF is nearest to the one it was fitted to.
    returns ModalErrors and the error of its FRF, or None where it finds no poles
    """
    structure, (outputs, inputs) = case.structure, dofs(case)
    stack = estimate.values.reshape(len(estimate.frequency), -1).T.copy()
    if form == "accelerance":
        stack *= -((2 * np.pi * estimate.frequency) ** 2)
    stack[:, 0] = 0.0
    best, least = None, np.inf
    for order in orders:
        model = _ema_model(structure, estimate.frequency, stack, form, order)
        if model is None:
            continue
        inside = (model.freq >= structure.band[0]) & (model.freq <= structure.band[1])
        left = float(np.linalg.norm((model.H - model.frf)[:, inside]))
        if left < least:
            best, least = model, left
    if best is None:
        return None
    shape = (len(outputs), len(inputs))
    found = modal_errors(structure, best.nat_freq, best.nat_xi, best.A.T.reshape(-1, *shape), outputs, inputs)
    return found, frf_error(structure, best.freq, best.H.T.reshape(-1, *shape), form, outputs, inputs)


def _ema_model(structure, frequency, stack, form, order):
    """A fitted model, or None where it fails.   stack : (channel, frequency) in `form`"""
    from sdypy import EMA

    fn = structure.natural_frequency[structure.in_band]
    low, high = structure.band
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        model = EMA.Model(stack, frequency, lower=low, upper=high, pol_order_high=order, frf_form=form)
        try:
            model.get_poles(method="lscf", show_progress=False)
            model.select_closest_poles(list(fn), f_window=min(50, int(np.diff(fn).min())))
            model.get_constants()
        except (ValueError, IndexError, np.linalg.LinAlgError):
            return None
    return model
