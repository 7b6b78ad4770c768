"""What the study of forces from accelerations found, as plain numbers: errors in per cent, and the claims of the paper."""

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from millcal.studies import forces_from_accelerations as study
from millcal.studies.forces_bands import BANDS, FRF_ERRORS, RATIOS
from millcal.studies.forces_cuts import PASSINGS, SOUGHT
from millcal.studies.forces_from_accelerations import ANGLE, ANGLES, ENSEMBLE, ENSEMBLE_NOISE, FRFS, Study
from millcal.studies.forces_further import NOISE, WAYS
from millcal.studies.forces_methods import (
    GCV,
    GTLS,
    GTLS_WINDOWED,
    L_CURVE,
    LS,
    LS_ALL,
    METHODS,
    RTLS,
    RTLS_PRINTED,
    TLS,
    WEIGHTED,
)

BINS = (0.0, 2.5, 5.0, 7.5, 10.0, 12.5, 15.0, 20.0, 25.0)  # per cent, of the error of plain H1
MAIN = (0, 2)  # Ktc and Krc among SOUGHT, which the paper's Kc and Kt are
LIMIT = 10.0  # per cent, the paper's "does not exceed"
CONFIDENT = 1.959964  # standard deviations either side that hold 95 %


def summarise(found: Study) -> dict[str, Any]:
    """The result of the study for JSON."""
    levels = _Levels(found)
    return {
        "study": "forces-from-accelerations",
        "paper": "Pawelko et al., Estimation of cutting force model coefficients with regularized inverse problem, 2012, Figs. 6-9",
        "seed": found.seed,
        **found.extent._asdict(),
        "forces": list(found.extent.forces),
        "accelerations": list(found.extent.accelerations),
        "methods": list(METHODS),
        "coefficients": list(SOUGHT),
        "levels": list(_levels(levels)),
        "by_condition": list(_by_condition(levels)),
        "by_frf_error": list(_by_frf_error(levels)),
        "claims": [claim.summary() for claim in _claims(levels)],
        "comparisons": list(_comparisons(levels)),
        "bands": list(_bands(levels)),
        "coverage": list(_coverage(levels)),
        "ensemble": _ensemble(found),
        "angle": _angle(found),
        "further": _further(found),
    }


def rms_percent(error: np.ndarray) -> np.ndarray:
    """Over all axes but the last, of the coefficients.   error : relative, (..., 4)"""
    return np.asarray(100 * np.sqrt(np.mean(error**2, axis=tuple(range(error.ndim - 1)))))


class _Levels:
    """The runs, looked up by noise and method."""

    def __init__(self, found: Study) -> None:
        self.found, self.runs = found, found.runs
        self.forces, self.accelerations = found.extent.forces, found.extent.accelerations

    def error(self, force: float, acceleration: float, method: str) -> np.ndarray:
        """returns (repeat, passing, 4)"""
        at = self.forces.index(force), self.accelerations.index(acceleration)
        return np.asarray(self.runs.error[at][:, :, METHODS.index(method)])

    def rms(self, force: float, acceleration: float, method: str) -> np.ndarray:
        """Per cent.   returns (4,)"""
        return rms_percent(self.error(force, acceleration, method))

    def frf_error(self, force: float, acceleration: float) -> np.ndarray:
        """Means of plain, windowed and modal, (3,)"""
        at = self.forces.index(force), self.accelerations.index(acceleration)
        return np.asarray(self.runs.frf_error[at].mean(axis=(0, 1)))

    def has(self, force: float, acceleration: float) -> bool:
        return force in self.forces and acceleration in self.accelerations

    def noisy(self) -> Iterator[tuple[float, float]]:
        """All levels but that without noise."""
        yield from ((f, a) for f in self.forces for a in self.accelerations if f or a)

    def along_acceleration(self) -> list[tuple[float, float]]:
        """The levels of Fig. 6, noise in the accelerations alone, but for that without."""
        return [(0.0, a) for a in self.accelerations if a and 0.0 in self.forces]

    def variants(self) -> tuple[np.ndarray, np.ndarray]:
        """The error of plain H1 and the mean squares of the relative errors of the paper's variants, those without noise left out.

        returns (variant,), (variant, method, 4)
        """
        noisy = np.add.outer(self.forces, self.accelerations) > 0
        frf = self.runs.frf_error[noisy][..., FRFS.index("plain")].mean(axis=1)  # (level, passing)
        squares = np.mean(self.runs.error[noisy] ** 2, axis=1)  # (level, passing, method, 4)
        return frf.ravel(), squares.reshape(-1, *squares.shape[2:])


def _named(values: np.ndarray) -> dict[str, float]:
    return {name: float(value) for name, value in zip(SOUGHT, values, strict=True)}


def _levels(levels: _Levels) -> Iterator[dict[str, Any]]:
    for force in levels.forces:
        for acceleration in levels.accelerations:
            yield {
                "force_noise_N": force,
                "acceleration_noise_m_per_s2": acceleration,
                "frf_error_percent": dict(
                    zip(FRFS, (100 * levels.frf_error(force, acceleration)).tolist(), strict=True)
                ),
                "rmse_percent": {method: _named(levels.rms(force, acceleration, method)) for method in METHODS},
            }


def _by_condition(levels: _Levels) -> Iterator[dict[str, Any]]:
    """Of all noisy levels together, as in Fig. 8."""
    noisy = np.add.outer(levels.forces, levels.accelerations) > 0
    error = levels.runs.error[noisy]  # (level, repeat, passing, method, 4)
    for k in np.argsort(levels.found.condition):
        yield {
            "tooth_passing_hz": PASSINGS[k],
            "condition_number": float(levels.found.condition[k]),
            "rmse_percent": {method: _named(rms_percent(error[:, :, k, m])) for m, method in enumerate(METHODS)},
        }


def _by_frf_error(levels: _Levels) -> Iterator[dict[str, Any]]:
    frf, squares = levels.variants()
    for low, high in itertools.pairwise(BINS):
        inside = (100 * frf > low) & (100 * frf <= high)
        if inside.any():
            rms = 100 * np.sqrt(squares[inside].mean(axis=0))
            yield {
                "from_percent": low,
                "to_percent": high,
                "variants": int(inside.sum()),
                "rmse_percent": {method: _named(rms[m]) for m, method in enumerate(METHODS)},
            }


class Claim(NamedTuple):
    """What the paper says, in words and as a number, beside what is found."""

    printed: str
    found: str
    holds: bool
    said_by: str = "paper"

    def summary(self) -> dict[str, Any]:
        return {**self._asdict(), "holds": bool(self.holds)}


def _wins(levels: _Levels, method: str, other: str) -> tuple[int, int]:
    """In how many of the noisy levels a method has the smaller error of Ktc or Krc, and of how many."""
    better = [levels.rms(*level, method)[i] < levels.rms(*level, other)[i] for level in levels.noisy() for i in MAIN]
    return sum(map(int, better)), len(better)


def _claims(levels: _Levels) -> Iterator[Claim]:
    yield from _claims_of_limits(levels)
    yield _against(levels, "RTLS is more accurate than LS", RTLS, LS)
    yield _against(levels, "Tikhonov with GCV is less accurate than LS", LS, GCV)
    yield _against(levels, "Tikhonov with the L-curve is the least accurate, after GCV", GCV, L_CURVE, ties=True)
    yield _negative(levels)
    yield from _claims_of_noise(levels)
    yield from _claims_of_condition(levels)
    yield _against(levels, "GTLS is more accurate than LS", GTLS, LS, said_by="this study")
    yield _against(levels, "GTLS is more accurate than RTLS", GTLS, RTLS, said_by="this study")
    yield _against(levels, "GTLS is more accurate than LS with all rows", GTLS, LS_ALL, said_by="this study")
    windows = "GTLS of windowed H1 is more accurate than of plain H1"
    yield _against(levels, windows, GTLS_WINDOWED, GTLS, said_by="this study")
    worst = min(
        float(levels.rms(f, a, RTLS_PRINTED)[i]) for f in levels.forces for a in levels.accelerations for i in MAIN
    )
    yield Claim(
        "RTLS with the printed row of eq. 21 is wrong by more than 80 %, noise or not",
        f"Ktc and Krc by {worst:.0f} % or more at every level",
        worst > 80,
        "this study",
    )


def _claims_of_limits(levels: _Levels) -> Iterator[Claim]:
    along = [level for level in levels.along_acceleration() if level[1] <= 1.0]
    if along:
        rms = np.array([levels.rms(*level, RTLS)[list(MAIN)] for level in along])
        worst = rms.max(axis=0)
        good = list(itertools.takewhile(lambda row: row.max() <= LIMIT, rms))
        reach = f"up to {along[len(good) - 1][1]:g} m/s²" if good else "at no level"
        yield Claim(
            "RTLS: Ktc and Krc within 10 % up to 1.0 m/s²",
            f"{worst[0]:.1f} and {worst[1]:.1f} % at worst; both within 10 % {reach}",
            bool(worst.max() <= LIMIT),
        )
    frf, squares = levels.variants()
    m, inside = METHODS.index(RTLS), frf <= 0.15
    if inside.any():
        met = 100 * np.sqrt(squares[inside][:, m][:, list(MAIN)]) <= LIMIT
        share = 100 * met.mean(axis=0)
        yield Claim(
            "RTLS: Ktc and Krc within 10 % up to an FRF error of 15 %",
            f"in {share[0]:.0f} and {share[1]:.0f} % of {inside.sum()} variants",
            bool(met.all()),
        )


def _against(
    levels: _Levels, printed: str, better: str, worse: str, *, said_by: str = "paper", ties: bool = False
) -> Claim:
    """That one method has the smaller error; not settled if the other has it in more than a tenth of the levels.

    ties : the two may be the same method at many levels, which is told
    """
    wins, of = _wins(levels, better, worse)
    losses, _ = _wins(levels, worse, better)
    ratios = [
        levels.rms(*level, worse)[i] / max(levels.rms(*level, better)[i], 1e-9)
        for level in levels.noisy()
        for i in MAIN
    ]
    same = f", the same in {of - wins - losses}" if ties else ""
    found = f"{better} has the smaller error in {wins} of {of}{same}; {worse} / {better} {min(ratios):.2f} to {max(ratios):.2f}"
    return Claim(printed, found, wins >= 0.9 * of, said_by)


def _negative(levels: _Levels) -> Claim:
    """Of all noisy runs."""
    noisy = np.add.outer(levels.forces, levels.accelerations) > 0
    error = levels.runs.error[noisy]

    def share(method: str) -> float:
        return 100 * float(np.mean(np.any(error[:, :, :, METHODS.index(method)] < -1, axis=-1)))

    tls, ls = share(TLS), share(LS)
    found = f"a coefficient is negative in {tls:.1f} % of the runs of TLS and in {ls:.1f} % of those of LS"
    return Claim("TLS often gives negative coefficients, so it is left out", found, tls > 2 * ls and tls > 5)


def _claims_of_noise(levels: _Levels) -> Iterator[Claim]:
    force, acceleration = (study.FORCES[-1], 0.0), (0.0, study.ACCELERATIONS[-1])
    if not levels.has(*force) or not levels.has(*acceleration):
        return
    ratios = [levels.rms(*acceleration, LS)[i] / levels.rms(*force, LS)[i] for i in MAIN]
    yield Claim(
        "noise of the hammer matters by one order less than that of the accelerations",
        f"LS: {ratios[0]:.1f} and {ratios[1]:.1f} times less at {force[0]:g} N than at {acceleration[1]:g} m/s²",
        min(ratios) >= 5,
    )


def _claims_of_condition(levels: _Levels) -> Iterator[Claim]:
    condition = np.log(levels.found.condition)
    rows = list(_by_condition(levels))
    order = np.argsort(levels.found.condition)

    def correlation(method: str) -> float:
        errors = np.log([row["rmse_percent"][method]["Ktc"] for row in rows])
        return float(np.corrcoef(condition[order], errors)[0, 1])

    worst, best = rows[-1], min(rows, key=lambda row: row["rmse_percent"][LS]["Ktc"])
    yield Claim(
        "the condition number of the FRF has no significant influence",
        f"correlation of its logarithm with that of the error of Ktc: LS {correlation(LS):.2f}, RTLS {correlation(RTLS):.2f}, "
        f"GTLS {correlation(GTLS):.2f}; LS {worst['rmse_percent'][LS]['Ktc']:.1f} % at condition "
        f"{worst['condition_number']:.1f}, {best['rmse_percent'][LS]['Ktc']:.1f} % at {best['condition_number']:.1f}",
        abs(correlation(LS)) < 0.3,
    )


def _comparisons(levels: _Levels) -> Iterator[dict[str, Any]]:
    """Ratios of errors at the levels that have bands."""
    for level in FRF_ERRORS:
        if levels.has(*level):
            for method, other in RATIOS[level]:
                ratio = levels.rms(*level, method) / levels.rms(*level, other)
                yield {**_at(level), "method": method, "other": other, "ratio": _named(ratio)}


def _at(level: tuple[float, float]) -> dict[str, float]:
    return {"force_noise_N": level[0], "acceleration_noise_m_per_s2": level[1]}


def _bands(levels: _Levels) -> Iterator[dict[str, Any]]:
    """What is found beside where 998 of 1000 repetitions of the study would be."""

    def row(
        level: tuple[float, float], what: str, name: str, value: float, band: tuple[float, float]
    ) -> dict[str, Any]:
        inside = bool(band[0] <= value <= band[1])
        return {
            **_at(level),
            "what": what,
            "of": name,
            "found": value,
            "from": band[0],
            "to": band[1],
            "inside": inside,
        }

    for level in FRF_ERRORS:
        if not levels.has(*level):
            continue
        for name, value, band in zip(FRFS, 100 * levels.frf_error(*level), FRF_ERRORS[level], strict=True):
            yield row(level, "FRF error, %", name, float(value), band)
        for method, bands in BANDS[level].items():
            rms = levels.rms(*level, method)
            for i, band in zip(MAIN, bands, strict=True):
                yield row(level, f"{SOUGHT[i]}, %", method, float(rms[i]), band)
        for (method, other), bands in RATIOS[level].items():
            ratio = levels.rms(*level, method) / levels.rms(*level, other)
            for i, band in zip(MAIN, bands, strict=True):
                yield row(level, f"{SOUGHT[i]}, ratio", f"{method} / {other}", float(ratio[i]), band)


def coverage_percent(error: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """How often the 95 % interval holds the truth.   error, deviation : (..., 4)   returns (4,)"""
    held = np.abs(error) <= CONFIDENT * deviation
    return np.asarray(100 * np.mean(held, axis=tuple(range(held.ndim - 1))))


def _coverage(levels: _Levels) -> Iterator[dict[str, Any]]:
    """Of all noisy levels with noise in the accelerations, and level by level."""
    runs = levels.runs
    for m, method in enumerate(WEIGHTED):
        error, deviation = runs.error[..., METHODS.index(method), :], runs.deviation[..., m, :]
        loud = np.asarray(levels.accelerations) > 0
        yield {
            "method": method,
            "force_noise_N": None,
            "acceleration_noise_m_per_s2": None,
            "coverage_percent": _named(coverage_percent(error[:, loud], deviation[:, loud])),
        }
        for level in levels.noisy():
            at = levels.forces.index(level[0]), levels.accelerations.index(level[1])
            yield {
                "method": method,
                **_at(level),
                "coverage_percent": _named(coverage_percent(error[at], deviation[at])),
            }


def _ensemble(found: Study) -> dict[str, Any]:
    """Every structure, and how many keep Ktc and Krc within 10 %."""
    error = found.ensemble.error
    rms = np.array([[rms_percent(own[:, :, m]) for m in range(len(ENSEMBLE))] for own in error])
    main = rms[:, :, list(MAIN)]  # (structure, method, 2)
    ratio = np.exp(np.mean(np.log(main / main[:, [0]]), axis=0))
    return {
        "force_noise_N": ENSEMBLE_NOISE[0],
        "acceleration_noise_m_per_s2": ENSEMBLE_NOISE[1],
        "structures": len(rms),
        "within_10_percent": {
            method: int(np.sum(np.all(main[:, m] <= LIMIT, axis=1))) for m, method in enumerate(ENSEMBLE)
        },
        "ratio_to_LS": {
            method: {SOUGHT[i]: float(ratio[m, k]) for k, i in enumerate(MAIN)} for m, method in enumerate(ENSEMBLE)
        },
        "range_percent": {
            method: {SOUGHT[i]: [float(main[:, m, k].min()), float(main[:, m, k].max())] for k, i in enumerate(MAIN)}
            for m, method in enumerate(ENSEMBLE)
        },
        "each": [
            {
                "condition_number": [float(own.min()), float(own.max())],
                "rmse_percent": {method: _named(row[m]) for m, method in enumerate(ENSEMBLE)},
            }
            for own, row in zip(found.ensemble.condition, rms, strict=True)
        ],
    }


def _angle(found: Study) -> dict[str, Any]:
    error, deviation, angle = found.angles
    fitted = np.degrees(angle[..., 0])
    return {
        "force_noise_N": study.ANGLE_NOISE[0],
        "acceleration_noise_m_per_s2": study.ANGLE_NOISE[1],
        "angle_deg": float(np.degrees(ANGLE)),
        "fitted_mean_deg": float(fitted.mean()),
        "fitted_sd_deg": float(fitted.std(ddof=1)),
        "bound_sd_deg": float(np.degrees(np.sqrt(np.mean(angle[..., 1] ** 2)))),
        "ways": {
            way: {
                "bias_percent": _named(100 * error[:, :, w].mean(axis=(0, 1))),
                "rmse_percent": _named(rms_percent(error[:, :, w])),
                "bound_percent": _named(rms_percent(deviation[:, :, w])),
                "coverage_percent": _named(coverage_percent(error[:, :, w], deviation[:, :, w])),
            }
            for w, way in enumerate(ANGLES)
        },
    }


def _further(found: Study) -> dict[str, Any]:
    """Each way with its error, its bias, the bound where it is reckoned, and how often its intervals hold."""
    rows = []
    for group, ways in WAYS.items():
        for way in ways:
            if way in found.further:
                error, deviation, bound = found.further[way]
                rows.append(
                    {
                        "group": group,
                        "way": way,
                        "answers": int(np.prod(error.shape[:2])),
                        "rmse_percent": _named(rms_percent(error)),
                        "bias_percent": _named(100 * error.mean(axis=(0, 1))),
                        "bound_percent": _named(rms_percent(bound)) if np.isfinite(bound).all() else None,
                        "coverage_percent": _named(coverage_percent(error, deviation)),
                    }
                )
    return {"force_noise_N": NOISE[0], "acceleration_noise_m_per_s2": NOISE[1], "ways": rows}
