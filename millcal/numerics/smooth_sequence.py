"""A smooth course through a noisy sequence, as smooth as the sequence itself says.

The smoothest curve near the values minimises sum w (y - z)^2 + penalty sum (second differences of z)^2. That is the estimate
of an integrated random walk seen through white noise, so the penalty, the ratio of the two variances, has a likelihood;
where there is nothing but noise about a straight line it ends at the straight line.
"""

import numpy as np

PENALTIES = 10.0 ** np.arange(-2.0, 14.1, 0.5)


def smooth_sequence(values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """The smooth course through equally spaced values, by restricted maximum likelihood.

    values : (n,)   weights : (n,), 0 where a value is missing; None: all 1   returns (n,)
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    n = len(values)
    w = np.ones(n) if weights is None else np.asarray(weights, float)
    seen = w > 0
    if seen.sum() < 2:
        raise ValueError(f"{int(seen.sum())} values carry no course")
    line = np.polynomial.Polynomial.fit(np.flatnonzero(seen), values[seen], 1, w=np.sqrt(w[seen]))(np.arange(n))
    if seen.sum() < 4:
        return line
    y = np.where(seen, values - line, 0.0)
    curvature = _penalty_bands(n)
    best, course = np.inf, np.zeros(n)
    for penalty in PENALTIES:
        bands = penalty * curvature
        bands[0] += w
        try:
            factor = cholesky_banded(bands, lower=True)
        except np.linalg.LinAlgError:  # so stiff that the line is all that is left
            continue
        z = cho_solve_banded((factor, True), w * y)
        unexplained = max(float(np.sum(w * y * (y - z))), 1e-300)
        cost = (seen.sum() - 2) * np.log(unexplained) + 2 * np.sum(np.log(factor[0])) - (n - 2) * np.log(penalty)
        if cost < best:
            best, course = cost, z
    return line + course


def _penalty_bands(n: int) -> np.ndarray:
    """D^T D of the second differences, its diagonal and two below.   returns (3, n)"""
    bands = np.zeros((3, n))
    for i, a in enumerate((1.0, -2.0, 1.0)):
        for j, b in enumerate((1.0, -2.0, 1.0)):
            if i >= j:  # row k + i, column k + j
                bands[i - j, j : j + n - 2] += a * b
    return bands
