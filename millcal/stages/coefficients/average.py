"""Cutting coefficients from the mean forces of cuts at several feeds: linear-edge law, any immersion.

The mean force over whole revolutions is linear in the six coefficients [Altintas, Manufacturing Automation, sec. 2.8.1; for
a slot eq. 2.55]. Runout shares the same chip out unequally, so the cutting part of the mean stays; but a tooth that is out
of the cut has no edge force, and where the chip goes to nothing (both ends of a slot) any runout takes a tooth out. What is
missing depends on the feed, the mean bends, and one more unknown, the runout c0 that it takes, describes the bend.

The intervals come from the scatter of the cuts about the model. What the noise within a record would give is 10 to 40
times narrower and says nothing of the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from millcal.data import AXES, CutForce, Notice, Posterior
from millcal.errors import IllPosedError
from millcal.numerics.jackknife import student_quantile
from millcal.numerics.separable_least_squares import solve_linear
from millcal.physics.cutting_force import force_basis, linear_edge_functions

NAMES = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")
UNITS = ("N/m^2", "N/m^2", "N/m^2", "N/m", "N/m", "N/m")


@dataclass(frozen=True, eq=False)
class MeanForceFit:
    """The regression of mean forces, with or without contact loss."""

    coefficients: np.ndarray  # (6,), in the order of NAMES
    covariance: np.ndarray  # (6,), then c0 where it is fitted
    dof: float
    runout: float  # c0, m
    modelled: np.ndarray  # (cut, axis), N
    residual: np.ndarray  # (cut, axis), N
    squared_sum: float  # N^2
    matrix: np.ndarray  # mean force per unit of each coefficient, (cut, axis, 6)
    interval: np.ndarray  # 95 %, (6 or 7, low and high)


@dataclass(frozen=True)
class ContactLoss:
    """Whether a runout c0 that takes a tooth out of the cut explains what the line leaves."""

    runout: float  # c0, m
    ratio: float  # of the sums of squares, with over without
    f_value: float  # nominal F of the one unknown
    explains: bool


NO_CONTACT_LOSS = ContactLoss(0.0, 1.0, 0.0, False)


def mean_forces(cuts: Sequence[CutForce], rows: str) -> np.ndarray:
    """Mean force of every cut over whole revolutions, or over all rows of the steady part.   returns (cut, axis) N"""
    if rows == "all":
        return np.stack([cut.mean_all_rows for cut in cuts])
    return np.stack([cut.harmonics[:, 0].real for cut in cuts])


def mean_force_matrix(cuts: Sequence[CutForce], runout: float) -> np.ndarray:
    """Mean force per unit of each coefficient, in the order of NAMES.   runout : c0, m   returns (cut, axis, 6)"""
    blocks = []
    for cut in cuts:
        offset = runout * np.cos(cut.cutter.tooth_lag())[:, np.newaxis]
        basis = force_basis(linear_edge_functions, cut.cutter, cut.conditions, 0, offset=lambda z, e=offset: e + 0 * z)
        blocks.append(basis[:, :, ::-1, 0].real.transpose(0, 2, 1).reshape(3, 6))  # cutting before edge
    return np.stack(blocks)


def solve_means(cuts: Sequence[CutForce], forces: np.ndarray, runout: float) -> MeanForceFit:
    """Least squares of the mean forces at one runout, with the covariance from the scatter of the cuts.

    The residuals of one cut in x, y and z are taken as correlated and the cuts as independent; each axis has two unknowns
    of its own (one line), so that n cuts leave n - 2 degrees of freedom. For slots these are the intervals of three
    straight lines.

    forces : (cut, axis) N   runout : c0, m
    """
    matrix = mean_force_matrix(cuts, runout)
    n = len(cuts)
    theta = solve_linear(matrix.reshape(-1, 6), forces.ravel())
    modelled = matrix @ theta
    residual = forces - modelled
    covariance = np.full((6, 6), np.nan)
    if n > 2:
        scale = np.linalg.norm(matrix.reshape(-1, 6), axis=0)
        inverse = np.linalg.pinv(matrix.reshape(-1, 6) / scale).reshape(6, n, 3) / scale[:, np.newaxis, np.newaxis]
        covariance = np.einsum("pci,ij,qcj->pq", inverse, residual.T @ residual / (n - 2), inverse)
    half = student_quantile(n - 2) * np.sqrt(np.diag(covariance))
    interval = np.stack([theta - half, theta + half], axis=1)
    return MeanForceFit(
        theta, covariance, n - 2.0, runout, modelled, residual, float(np.sum(residual**2)), matrix, interval
    )


def search_contact_loss(cuts: Sequence[CutForce], forces: np.ndarray) -> tuple[MeanForceFit, ContactLoss]:
    """The runout c0 whose contact loss explains most of what the straight line leaves.

    The fit with that runout, and whether it is worth its unknown (F at one in a hundred). Only the amount of contact loss is
    determined by the means; its shape is not (a taper does as well), so c0 here is an effective number. The sum of squares
    is far from a parabola in c0, so the intervals are profiles: a value of a coefficient belongs to the interval if some c0
    with it comes within t^2 / dof of the smallest sum of squares [Bates & Watts 1988, sec. 6.1].
    """
    largest = largest_runout(cuts)
    free = 3 * len(cuts) - 7
    force_squares = float(np.sum(forces**2))
    fits = [solve_means(cuts, forces, c0) for c0 in np.linspace(0.0, largest, 61)]
    plain, step = fits[0], largest / 60
    for _ in range(6):  # closer about the minimum, until the profile is seen from end to end
        best = min(fits, key=lambda fit: fit.squared_sum)
        smallest = max(best.squared_sum, 1e-14 * force_squares)
        allowed = smallest * (1 + student_quantile(free) ** 2 / free) if free > 0 else np.inf
        inside = [fit.runout for fit in fits if fit.squared_sum <= allowed]
        if len(inside) > 12 or step < 1e-11:
            break
        low, high = max(min(inside) - step, 0.0), min(max(inside) + step, largest)
        fits += [solve_means(cuts, forces, c0) for c0 in np.linspace(low, high, 31)[1:-1]]
        step = (high - low) / 30
    lowest, highest = np.full(7, np.inf), np.full(7, -np.inf)
    for trial in fits:
        if trial.squared_sum > allowed:
            continue
        matrix = trial.matrix.reshape(-1, 6)
        scale = np.linalg.norm(matrix, axis=0)
        unit = np.diag(np.linalg.pinv((matrix / scale).T @ (matrix / scale))) / scale**2
        half = np.append(np.sqrt(unit * (allowed - trial.squared_sum)), step)
        value = np.append(trial.coefficients, trial.runout)
        lowest, highest = np.minimum(lowest, value - half), np.maximum(highest, value + half)
    spread = (highest - lowest) / 2 / student_quantile(free) if free > 0 else np.full(7, np.nan)
    correlation = np.eye(7)
    if np.all(np.isfinite(best.covariance)):
        sd = np.sqrt(np.diag(best.covariance))
        correlation[:6, :6] = best.covariance / np.maximum(np.outer(sd, sd), 1e-300)
    f_value = (plain.squared_sum - best.squared_sum) / (smallest / free) if free > 0 else 0.0
    ratio = best.squared_sum / plain.squared_sum if plain.squared_sum > 0 else 1.0
    explains = free > 0 and best.runout > 0 and f_value > f_quantile(free) and plain.squared_sum > 1e-10 * force_squares
    interval = np.stack([lowest, highest], axis=1)
    best = replace(best, covariance=correlation * np.outer(spread, spread), dof=float(free), interval=interval)
    return best, ContactLoss(best.runout, ratio, f_value, explains)


def largest_runout(cuts: Sequence[CutForce]) -> float:
    """c0 at which a tooth stands out by the smallest feed: beyond it that cut is one of fewer teeth, and says nothing more."""
    step = np.abs(np.diff(np.cos(cuts[0].cutter.tooth_lag()), append=1.0)).max()
    return min(cut.conditions.feed_per_tooth for cut in cuts) / float(step)


def f_quantile(dof: int) -> float:
    """F(1, dof) that chance exceeds once in a hundred."""
    from scipy.special import fdtri

    return float(fdtri(1, dof, 0.99))


def check_feeds(cuts: Sequence[CutForce]) -> None:
    """The mean forces must tell six coefficients apart: two feeds at least, or two immersions.

    Raises
    ------
    IllPosedError
    """
    matrix = mean_force_matrix(cuts, 0.0).reshape(-1, 6)
    scale = np.linalg.norm(matrix, axis=0)
    values = np.linalg.svd(matrix / np.where(scale > 0, scale, 1.0), compute_uv=False)
    if len(cuts) < 2 or values[-1] < 5e-3 * values[0]:
        feeds = sorted({round(cut.conditions.feed_per_tooth * 1e3, 4) for cut in cuts})
        told = (
            f"one feed per tooth ({feeds[0]:g} mm)" if len(feeds) == 1 else f"feeds of {feeds[0]:g} to {feeds[-1]:g} mm"
        )
        raise IllPosedError(
            f"cuts: {len(cuts)} at {told} cannot tell K_c from K_e by their mean forces; "
            "add cuts at other feeds, or use method nls"
        )


def posterior_of(fit: MeanForceFit) -> Posterior:
    """The six coefficients (and c0 where it was fitted) with covariance and interval."""
    with_runout = len(fit.interval) == 7
    return Posterior(
        names=(*NAMES, "c0") if with_runout else NAMES,
        units=(*UNITS, "m") if with_runout else UNITS,
        mean=np.append(fit.coefficients, fit.runout) if with_runout else fit.coefficients,
        covariance=fit.covariance,
        interval=fit.interval,
        law="linear-edge",
        method="average",
        dof=fit.dof if fit.dof > 0 else np.inf,
    )


def r_squared(forces: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """1 - SSE/SST of the means over the cuts.   forces, residual : (cut, axis)   returns (axis,)"""
    total = np.sum((forces - forces.mean(axis=0)) ** 2, axis=0)
    return 1 - np.sum(residual**2, axis=0) / np.where(total > 0, total, np.inf)


def lack_of_fit(cuts: Sequence[CutForce], residual: np.ndarray) -> np.ndarray:
    """F of the model's misfit against the noise of the means, from blocks of revolutions.   returns (axis,)"""
    noise = np.mean([cut.harmonics_variance[:, 0].real for cut in cuts], axis=0)
    return np.sum(residual**2, axis=0) / max(len(cuts) - 2, 1) / np.where(noise > 0, noise, np.inf)


# what the tool's x and y could be instead: name, and (x, y) as a 2x2 matrix of the present ones
_OTHER_MAPS = {
    "fx=+{y}, fy=+{x}": ((0, 1), (1, 0)),
    "fx=-{y}, fy=-{x}": ((0, -1), (-1, 0)),
    "fx=+{y}, fy=-{x}": ((0, 1), (-1, 0)),
    "fx=-{y}, fy=+{x}": ((0, -1), (1, 0)),
    "fx=-{x}, fy=-{y}": ((-1, 0), (0, -1)),
    "fx=-{x}, fy=+{y}": ((-1, 0), (0, 1)),
    "fx=+{x}, fy=-{y}": ((1, 0), (0, -1)),
}


def axis_map_notices(cuts: Sequence[CutForce], forces: np.ndarray) -> tuple[Notice, ...]:
    """Whether signs and sizes of the coefficients betray a wrong axis map, and which map would mend it.

    Ktc, Krc, Kte and Kre are positive and Ktc > Krc for every metal cut with a sound edge. In a slot a swap exchanges Ktc
    and Krc and leaves the residual as it is, so only this tells; at partial immersion the residual falls as well.
    """
    fit = solve_means(cuts, forces, 0.0)
    theta, squares = fit.coefficients, fit.squared_sum
    chance = np.where(
        np.isfinite(fit.interval[:, 1]), fit.interval[:, 1] - theta, 0.0
    )  # what may be negative by chance
    if np.all((theta > -chance)[[0, 1, 3, 4]]) and theta[0] > 0 and theta[1] - theta[0] < chance[1]:
        return ()
    wrong = []
    if theta[0] <= 0:
        wrong.append(f"Ktc is negative ({theta[0] / 1e6:.4g} N/mm2)")
    if theta[1] > theta[0] > 0:
        wrong.append(f"Krc ({theta[1] / 1e6:.4g}) is larger than Ktc ({theta[0] / 1e6:.4g} N/mm2)")
    if theta[1] <= -chance[1]:
        wrong.append(f"Krc is negative ({theta[1] / 1e6:.4g} N/mm2)")
    wrong += [
        f"{name} is negative ({value / 1e3:.4g} N/mm)"
        for name, value, limit in zip(NAMES[3:5], theta[3:5], chance[3:5], strict=True)
        if value <= -limit
    ]
    candidates = []
    for name, turn in _OTHER_MAPS.items():
        turned = forces.copy()
        turned[:, :2] = forces[:, :2] @ np.array(turn).T
        trial = solve_means(cuts, turned, 0.0)
        other, other_squares = trial.coefficients, trial.squared_sum
        if (
            np.all(other[[0, 1, 3, 4]] > 0)
            and other[0] > other[1]
            and other_squares <= 2.0 * squares + 1e-9 * float(np.sum(forces**2))
        ):
            candidates.append(
                (other_squares, name.format(x="(present fx)", y="(present fy)"), other, "{y}" in name.split(",")[0])
            )
    if not candidates:
        code, mending = (
            "sign",
            "no exchange of x and y mends it: check direction (up or down), feed direction and offset",
        )
    else:
        other_squares, name, other, swapped = min(candidates, key=lambda item: item[0])
        code = "axis-swap" if swapped else "axis-sign"
        gain = (
            f", and the residual falls by {squares / max(other_squares, 1e-300):.3g}"
            if other_squares < 0.7 * squares
            else ""
        )
        mending = (
            f"{'the axes look swapped' if swapped else 'a sign looks turned'}: with {name} "
            f"Ktc is {other[0] / 1e6:.4g} and Krc {other[1] / 1e6:.4g} N/mm2, all positive{gain}; state the map"
        )
    return (Notice(code, f"{'; '.join(wrong)}; {mending}", "map"),)


def curvature_notice(forces: np.ndarray, residual: np.ndarray, cuts: Sequence[CutForce]) -> tuple[Notice, ...]:
    """Name the axes whose mean force bends over the feed by more than chance would (quadratic term, one in a hundred)."""
    feeds = np.array([cut.conditions.feed_per_tooth for cut in cuts])
    if (
        len(cuts) < 4
        or len(np.unique(np.round(feeds, 9))) < 3
        or len({(c.conditions.axial_depth, c.conditions.radial_depth, c.conditions.direction) for c in cuts}) > 1
    ):
        return ()
    u = (feeds - feeds.mean()) / np.ptp(feeds)
    powers = np.stack([np.ones_like(u), u, u**2], axis=1)
    curve = np.linalg.lstsq(powers, residual, rcond=None)[0]
    bent = residual - powers @ curve
    level = np.sqrt(np.sum(bent**2, axis=0) / (len(u) - 3) * np.linalg.inv(powers.T @ powers)[2, 2])
    found = [
        f"F{axis} {'concave' if curve[2, i] * np.sign(forces[:, i].mean()) < 0 else 'convex'} "
        f"({np.abs(residual[:, i]).max():.2g} N)"
        for i, axis in enumerate(AXES)
        if abs(curve[2, i]) > student_quantile(len(u) - 3, 0.99) * level[i]
        and np.abs(residual[:, i]).max() > 0.005 * np.abs(forces[:, i]).max()
    ]
    if not found:
        return ()
    return (
        Notice(
            "curvature",
            f"mean force bends over the feed: {', '.join(found)}; a straight line is not the whole truth",
            "cuts",
        ),
    )
