"""Histories of coefficients made by hand, as a filter or smoother gives them: wear with a chipped edge, cuts over minutes, bands
wide as a prior, and one of which hardly anything is known.
"""

from dataclasses import replace

import numpy as np

from millcal.data import Check, CoefficientHistory, Jump, Notice, Posterior
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import chip_thickness, to_machine_axes

CUTTER = Cutter(diameter=10e-3, teeth=2, helix=np.pi / 6)
SPEED = 2578.3 * 2 * np.pi / 60
DOWN = CuttingConditions(SPEED, 0.1e-3, 2e-3, 3e-3, "down")
NAMES = {"kienzle": ("k", "m"), "linear-edge": ("Kc", "Ke")}
UNITS = {"k": "N/m^2", "m": "1", "Kc": "N/m^2", "Ke": "N/m"}


def named(kind: str, direction: str) -> str:
    """kt, mt, Ktc, Kte"""
    return f"K{direction}{kind[1]}" if kind[0] == "K" else f"{kind}{direction}"


def edge_force(law: str, kappa: np.ndarray, shape: np.ndarray, chip: np.ndarray, h0: float) -> np.ndarray:
    """Force per width, N/m.   kappa, shape : (direction,)   chip : (...,) m   returns (..., 3)"""
    h = chip[..., np.newaxis]
    if law == "kienzle":
        force = np.exp(kappa) * h * (np.maximum(h, 1e-12) / h0) ** -shape
    else:
        force = np.exp(kappa) * ((1 - shape) * h + shape * h0)
    force = np.where(h > 0, force, 0.0)
    return np.concatenate([force, np.zeros((*chip.shape, 3 - len(kappa)))], axis=-1)


def force(law: str, kappa: np.ndarray, shape: np.ndarray, h0: float, c: CuttingConditions, angle: np.ndarray):
    """Force on the tool.   angle : (sample,) rad   returns (3, sample) N"""
    height = (np.arange(12) + 0.5) * c.axial_depth / 12
    chip = chip_thickness(CUTTER, c, angle, height)
    lag = CUTTER.tooth_lag()[:, np.newaxis] + CUTTER.helix_lag(height)
    edges = edge_force(law, kappa, shape, chip, h0) * c.axial_depth / 12
    return to_machine_axes(edges, angle - lag[:, :, np.newaxis]).sum(axis=(0, 1)).T


def history(
    *,
    law: str = "kienzle",
    directions: tuple[str, ...] = ("t", "r"),
    axes: tuple[str, ...] = ("x", "y"),
    duration: float = 12.0,  # s
    steps: int = 900,
    cuts: tuple[str, ...] = ("cuts/wear.h5",),
    wear: float = 0.12,  # of ln(specific force), over the whole time
    jump: float = 0.09,  # the same, at once
    settling: float = 0.0,  # share of the record until a filter's bands have come down from its prior
    precision: float = 1.0,  # times the usual width of the bands
    method: str = "smooth",
    misfit: float = 1.0,  # innovations in standard deviations
    seed: int = 11,
    **more,
) -> CoefficientHistory:
    """A history with drift, a jump at six tenths and bands; `more` replaces fields of the record."""
    rng = np.random.default_rng(seed)
    d, h0 = len(directions), 65e-6
    time = np.linspace(0.004, duration, steps)
    share = time / duration
    cut = np.minimum(share * len(cuts), len(cuts) - 1e-9).astype(int)
    jumped = (share > 0.62).astype(float)
    scale = np.array([1.0, 1.6, 0.7])[:d]
    kappa0 = np.log(np.array([2.78e9, 1.35e9, 0.55e9])[:d])
    shape0 = (np.array([0.18, 0.42, 0.3]) if law == "kienzle" else np.array([0.24, 0.4, 0.5]))[:d]
    truth = wear * (1 - np.exp(-2 * share)) / 0.865
    kappa = kappa0 + np.outer(truth, scale) + np.outer(jump * jumped, scale)
    shape = shape0 + np.outer(0.25 * truth, [0.1, -0.2, 0.05][:d])
    early = 1 + 40 * np.exp(-share / settling) if settling else np.ones(steps)
    sd_kappa = precision * 0.006 * np.outer(early, [1.0, 1.7, 2.6][:d])
    sd_shape = precision * 0.013 * np.outer(np.minimum(early, 18), [1.0, 0.8, 2.0][:d])
    kappa = kappa + 0.5 * sd_kappa * wandering(rng, steps, d)
    shape = shape + 0.5 * sd_shape * wandering(rng, steps, d)

    def coefficients(k: np.ndarray, s: np.ndarray) -> np.ndarray:
        if law == "kienzle":
            return np.concatenate([np.exp(k) * (h0 / 1e-3) ** s, s], axis=1)
        return np.concatenate([(1 - s) * np.exp(k), s * h0 * np.exp(k)], axis=1)

    names = tuple(named(kind, direction) for kind in NAMES[law] for direction in directions)
    units = tuple(UNITS[kind] for kind in NAMES[law] for _ in directions)
    draws = [
        coefficients(kappa + sd_kappa * rng.standard_normal((1, d)), shape + sd_shape * rng.standard_normal((1, d)))
        for _ in range(300)
    ]
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    value = coefficients(kappa, shape)
    last = np.array([draw[-1] for draw in draws])
    posterior = Posterior(
        names=(*names, "c0", "s0"),
        units=(*units, "m", "m"),
        mean=np.array([*value[-1], 6.6e-6, 9.5e-6]),
        covariance=np.pad(np.cov(last.T), (0, 2)) + np.diag([0.0] * len(names) + [2.5e-13, 4.4e-12]),
        interval=np.array([*zip(low[-1], high[-1], strict=True), (5.6e-6, 7.6e-6), (5.4e-6, 13.6e-6)]),
        law=law,
        method=method,
    )
    shown, window, modelled = [], [], []
    rate = 12000.0
    for number, at in enumerate((0.02, 0.5, 0.97)):
        instants = at * duration + np.arange(int(2.2 * 60 / 2578.3 * rate)) / rate
        step = int(np.searchsorted(time, instants[0]))
        shown.append(instants)
        window.append(np.full(len(instants), float(number)))
        modelled.append(force(law, kappa[step], shape[step], h0, DOWN, SPEED * instants))
    rows = ["xyz".index(axis) for axis in axes]
    fitted = np.concatenate(modelled, axis=1)[rows]
    noise = np.array([11.0, 9.0, 6.0])[rows]
    n = np.round(rng.uniform(20, 30, steps))
    a = len(axes)
    return replace(
        CoefficientHistory(
            posterior=posterior,
            method=method,
            cutter=CUTTER,
            conditions=(DOWN,) * len(cuts),
            cuts=cuts,
            verdict="fits",
            checks=(
                Check("residuals", True, "the stiff model leaves 1.02 times the noise"),
                Check("separable", True, "k and m are told apart: sd of mt 0.013, of ln kt 3.6 %"),
                Check("innovations", True, "white and as large as expected: rms 1.01"),
            ),
            time=time,
            cut=cut.astype(float),
            names=names,
            units=units,
            value=value,
            low=low,
            high=high,
            reference_chip=h0,
            directions=directions,
            specific_force=np.exp(kappa),
            specific_low=np.exp(kappa - 1.96 * sd_kappa),
            specific_high=np.exp(kappa + 1.96 * sd_kappa),
            axes=axes,
            innovation_mean=misfit * rng.standard_normal((steps, a)) / np.sqrt(n)[:, np.newaxis],
            innovation_square=misfit**2 * rng.chisquare(n[:, np.newaxis], (steps, a)) / n[:, np.newaxis],
            innovation_samples=n,
            shown=np.concatenate(shown),
            shown_window=np.concatenate(window),
            measured=fitted + noise[:, np.newaxis] * rng.standard_normal(fitted.shape),
            modelled=fitted,
            residual_rms=noise * 1.01,
            r2=np.array([0.982, 0.991, 0.87])[rows],
            noise=noise,
            noise_from="air",
            chi2=1.02 * misfit**2,
            chip_range=(21e-6, 98e-6),
            slope_per_minute=60 / duration * wear * scale,
            slope_low=60 / duration * wear * scale * 0.8,
            slope_high=60 / duration * wear * scale * 1.2,
            jumps=(Jump(0.62 * duration, tuple((jump * scale).tolist()), tuple((0.012 * scale).tolist()), 31.4),)
            if jump
            else (),
            runout=(6.6e-6, 9.5e-6),
            model="one shared trend with 1 jump; ln evidence 4.1 above independent trends",
        ),
        **more,
    )


def wandering(rng: np.random.Generator, steps: int, columns: int) -> np.ndarray:
    """Noise that changes slowly, of unit size.   returns (step, column)"""
    raw = rng.standard_normal((steps + 80, columns))
    smooth = np.stack([np.convolve(raw[:, i], np.hanning(81), mode="valid")[:steps] for i in range(columns)], axis=1)
    return smooth / np.sqrt(np.sum(np.hanning(81) ** 2))


def worn() -> CoefficientHistory:
    """One cut of twelve seconds with wear and a chipped edge, two directions, smoothed."""
    return history()


def two_cuts() -> CoefficientHistory:
    """Two cuts, eight minutes, three directions of the linear-edge law, filtered."""
    return history(
        law="linear-edge",
        directions=("t", "r", "a"),
        axes=("x", "y", "z"),
        duration=8 * 60.0,
        steps=4000,
        cuts=("cuts/pass1.h5", "cuts/pass2.h5"),
        settling=0.02,
        jump=0.0,
        method="imm",
        model="",
        noise_from="residual",
        notices=(Notice("no-air", "no air cut: the noise is that of the residual", "cuts/pass1.h5"),),
    )


def wide() -> CoefficientHistory:
    """An ensemble that does not tell k from m, and a model that leaves far more than noise."""
    return history(
        duration=0.4,
        steps=112,
        settling=0.2,
        precision=6.0,
        misfit=2.6,
        jump=0.0,
        method="enkf-inflated",
        verdict="does not fit: the residual is 2.6 times the noise; runout or a low-pass of the sensor is missing",
        checks=(
            Check("residuals", False, "the residual is 2.6 times the noise"),
            Check(
                "separable", False, "k and m are not separable here; the force is valid for chips of 21 to 98 um only"
            ),
        ),
        noise_from="idle",
        slope_low=np.array([-0.9, -2.0]),
        slope_high=np.array([40.0, 60.0]),
        model="",
    )


def unknown() -> CoefficientHistory:
    """Recursive least squares of a record so short that nothing but the values is known, and one of them is not."""
    full = history(steps=3, duration=0.01, jump=0.0, method="rls", model="")
    nothing = np.full_like(full.value, np.nan)
    no_band = np.full_like(full.specific_force, np.nan)
    slope = np.full(2, np.nan)
    value = full.value.copy()
    value[:, 1] = np.nan
    posterior = replace(
        full.posterior,
        covariance=np.full_like(full.posterior.covariance, np.nan),
        interval=np.full_like(full.posterior.interval, np.nan),
    )
    first = full.shown_window == 0
    return replace(
        full, posterior=posterior, value=value, low=nothing, high=nothing, specific_low=no_band, specific_high=no_band,
        slope_per_minute=slope, slope_low=slope, slope_high=slope, chi2=np.nan, innovation_samples=None, runout=None,
        shown=full.shown[first], shown_window=full.shown_window[first], measured=full.measured[:, first],
        modelled=full.modelled[:, first], r2=np.full(2, np.nan), noise_from="idle", checks=(), verdict="untested: 3 steps",
    )  # fmt: skip


MAKERS = {maker.__name__: maker for maker in (worn, two_cuts, wide, unknown)}
