"""How noise of the lines moves a crossing, to first order.

A change dG of the lines moves an eigenvalue of M(theta) by dlambda = y^H dM x / y^H x, with its left and right vectors, and
M is linear in G, harmonic by harmonic. A crossing must stay on the real axis: theta gives way by -Im dlambda / Im lambda',
lambda' = dlambda/dtheta, so that

    d(1/b) = -Re(kappa dlambda),     kappa = 1 + j Re lambda' / Im lambda',

and kappa = 1 for a flip, whose theta cannot move. Lines err independently; a spline between lines takes from some eight of
them, and opposite frequencies from the same ones, so that contributions are gathered line by line before they are squared.
Where Im lambda' is small, the eigenvalue only just touches the axis: there the spread is large, and rightly so, but a crossing
that noise alone makes or unmakes shows nowhere in it.
"""

from functools import cache

import numpy as np

from millcal.physics.stability.from_frf import CutBasis, MeasuredCut, circle_matrix, harmonics_within
from millcal.physics.stability.measured_receptance import STATIC_LINES

STEP = 1e-4  # rad, of theta for the slope
REACH = 8  # lines on either side from which the spline takes: the next has 3e-5


def inverse_depth_sd(
    problem: MeasuredCut, spindle_speed: float, basis: CutBasis, angle: float, depth: float, variance: np.ndarray
) -> float:
    """Standard deviation of 1/b of one crossing that circular complex errors of the lines cause, 1/m.

    spindle_speed : rad/s   angle : its theta, rad   depth : m   variance : E|dG|^2, (line, 2, 2) m^2/N^2
    """
    receptance, period = problem.receptance, problem.period(spindle_speed)
    angles = np.array([angle - STEP, angle, angle + STEP])
    before, at, after = circle_matrix(angles, basis, receptance, period)
    y_all, _, x_all = np.linalg.svd(at + np.eye(len(at)) / depth)
    y, x = y_all[:, -1].conj(), x_all[-1].conj()  # y: already conjugate
    product = y @ x
    slope = (y @ (after - before) @ x) / (2 * STEP * product)
    kappa = 1.0 + 0j if angle == np.pi else 1 + 1j * slope.real / slope.imag

    most = harmonics_within(receptance, period)
    out, back = (table[0] for table in basis.tables(angles[1:2], most))  # (harmonic, node)
    left = (out[:, basis.of] * y) @ basis.reads  # (harmonic, 2)
    right = (back[:, basis.of] * x) @ basis.forces
    by_entry = left[:, :, np.newaxis] * right[:, np.newaxis, :]
    by_entry = by_entry * (kappa * (1 - np.exp(-1j * angle)) / product)

    frequency = (angle / (2 * np.pi) + np.arange(-most, most)) / period
    by_entry = np.where((frequency < 0)[:, np.newaxis, np.newaxis], by_entry.conj(), by_entry)
    return float(np.sqrt(_gathered(problem, np.abs(frequency), by_entry, variance)))


def _gathered(problem: MeasuredCut, frequency: np.ndarray, by_entry: np.ndarray, variance: np.ndarray) -> float:
    """Variance of Re sum of by_entry dG over harmonics of the given frequencies, Hz."""
    lines = problem.receptance.frequency
    share = 1 - problem.receptance.share_of_mass_line(frequency)
    inside = (frequency >= lines[0]) & (frequency <= lines[-1]) & (share > 0)
    place = np.interp(frequency[inside], lines, np.arange(len(lines)))
    index = np.floor(place).astype(int)[:, np.newaxis] + np.arange(1 - REACH, REACH + 1)
    weight = _cardinal()(place[:, np.newaxis] - index) * share[inside, np.newaxis]
    weight[(index < 0) | (index >= len(lines))] = 0.0
    index = index.clip(0, len(lines) - 1)
    by_line = np.zeros((len(lines), 2, 2), complex)
    terms = weight[:, :, np.newaxis, np.newaxis] * by_entry[inside, np.newaxis]
    np.add.at(by_line, index.ravel(), terms.reshape(-1, 2, 2))
    total = 0.5 * float(np.sum(np.abs(by_line) ** 2 * variance))
    # Below the first line stands the median real part of a few: pi/2 times the variance of their mean.
    static = by_entry[frequency < lines[0]].sum(axis=0).real
    lowest = variance[:STATIC_LINES]
    return total + float(np.sum(static**2 * 0.5 * lowest.mean(axis=0))) * np.pi / 2 / len(lowest)


@cache
def _cardinal():  # type: ignore[no-untyped-def]
    """The cubic spline through 1 at 0 and 0 at all other whole numbers."""
    from scipy.interpolate import CubicSpline

    at = np.arange(-24, 25)
    return CubicSpline(at, (at == 0).astype(float))
