"""Linear systems A x = b that noise keeps from being solved exactly: least squares and its relatives.

    ls              |A x - b|^2                                            noise in b alone
    tls             |A x - b|^2 / (matrix_noise^2 |x|^2 + data_noise^2)    noise in A too, equal in all its entries
    tikhonov        |A x - b|^2 + regularization^2 |x|^2                   x is kept small
    constrained-ls  ls for the x with L x = 0
    rtls            tls for the x with |L x| <= slack: regularized total least squares

The denominator of total least squares is often printed as |x|^2 + 1. That is the case of equal noise in A and b, and the 1
then carries the unit of x: with another unit for x the answer is another one. So the two noises are parameters here; only
their ratio matters for x.

Everything works for real and for complex A. A constraint that is linear over the real numbers only (a conjugate in it) asks for
the real form of the whole system, `as_real`, in which the sums of squares above keep their values.

References
----------
.. [VanHuffel1991] S. Van Huffel, J. Vandewalle, The Total Least Squares Problem, SIAM 1991, sections 2.3 and 3.2.
.. [Golub1999] G. H. Golub, P. C. Hansen, D. P. O'Leary, Tikhonov regularization and total least squares, SIAM J. Matrix
   Anal. Appl. 21 (1999) 185-194, eq. 5.
.. [Dinkelbach1967] W. Dinkelbach, On nonlinear fractional programming, Management Science 13 (1967) 492-498.
.. [More1983] J. J. More, D. C. Sorensen, Computing a trust region step, SIAM J. Sci. Stat. Comput. 4 (1983) 553-572.
"""

import numpy as np

from millcal.errors import IllPosedError

ROUNDING = 1e-13  # singular values closer than this, relative to the largest, are one value
NON_GENERIC = 1e-12  # share of the data in the last singular vector below which total least squares has no solution
RANK = 1e-12  # of a constraint, relative
ROUNDS = 60  # of Dinkelbach at most; it takes about five


def as_real(A: np.ndarray) -> np.ndarray:
    """The real matrix that does to [Re x; Im x] what A does to x.   A : complex (m, n)   returns (2m, 2n)"""
    A = np.asarray(A)
    return np.block([[A.real, -A.imag], [A.imag, A.real]])


def as_real_vector(x: np.ndarray) -> np.ndarray:
    """[Re x; Im x], of a vector or of the columns of a matrix.   x : complex (n, ...)   returns (2n, ...)"""
    x = np.asarray(x)
    return np.concatenate([x.real, x.imag])


def as_complex_vector(x: np.ndarray) -> np.ndarray:
    """Back from [Re x; Im x].   x : (2n, ...)   returns complex (n, ...)"""
    real, imaginary = np.split(np.asarray(x), 2)
    return np.asarray(real + 1j * imaginary)


def condition_number(A: np.ndarray) -> float:
    """Largest over smallest singular value; inf where a column adds nothing.   A : (m, n)"""
    s = np.linalg.svd(A, compute_uv=False)
    if len(s) < np.shape(A)[1] or s[-1] <= np.finfo(float).eps * max(np.shape(A)) * s[0]:
        return float("inf")
    return float(s[0] / s[-1])


def null_basis(constraint: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the x with L x = 0.   constraint : L, (rows, n)   returns (n, n - rank)"""
    return _constraint_spaces(constraint)[0]


def least_squares(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """x that minimises |A x - b|^2, the shortest if there are many.   A : (m, n)   b : (m,)   returns (n,)"""
    return np.linalg.lstsq(A, b)[0]


def total_least_squares(
    A: np.ndarray, b: np.ndarray, *, matrix_noise: float = 1.0, data_noise: float = 1.0
) -> np.ndarray:
    """x that minimises |A x - b|^2 / (matrix_noise^2 |x|^2 + data_noise^2)  [VanHuffel1991]_.

    A : (m, n)   b : (m,)   returns (n,); where several x are as good, the shortest
    matrix_noise : standard deviation of an entry of A   data_noise : of an entry of b, not 0

    Raises
    ------
    IllPosedError
        There is no minimum: the objective falls on and on while x grows (A is nearly rank-deficient along a direction with
        which b has nothing to do; "non-generic").
    """
    _check_noise(matrix_noise, data_noise)
    if matrix_noise == 0:
        return least_squares(A, b)
    A, b = np.asarray(A), np.asarray(b)
    n = A.shape[1]
    together = np.column_stack([A / matrix_noise, b / data_noise])
    _, s, Vh = np.linalg.svd(together)
    s = np.concatenate([s, np.zeros(n + 1 - len(s))])
    V = Vh.conj().T[:, s - s[-1] <= ROUNDING * s[0]]  # all vectors of the smallest singular value
    share = float(np.linalg.norm(V[n]))
    if share < NON_GENERIC:
        raise IllPosedError(
            "total least squares: no finite solution, the matrix is nearly rank-deficient and the data do not show along which "
            "direction; add a constraint or data, or use least squares"
        )
    return np.asarray(-(data_noise / matrix_noise) * (V[:n] @ V[n].conj()) / share**2)


def tikhonov(A: np.ndarray, b: np.ndarray, *, regularization: float) -> np.ndarray:
    """x that minimises |A x - b|^2 + regularization^2 |x|^2.   regularization : unit of A"""
    A, b = np.asarray(A), np.asarray(b)
    n = A.shape[1]
    return least_squares(np.vstack([A, regularization * np.eye(n)]), np.concatenate([b, np.zeros(n)]))


def constrained_least_squares(A: np.ndarray, b: np.ndarray, constraint: np.ndarray) -> np.ndarray:
    """x with L x = 0 that minimises |A x - b|^2.   constraint : L, (rows, n), of any rank

    x = N z with an orthonormal basis N of the null space: |x| = |z|, and errors of A that are alike in all its entries stay
    alike in those of A N.
    """
    N = null_basis(constraint)
    return np.asarray(N @ least_squares(np.asarray(A) @ N, b))


def constrained_total_least_squares(
    A: np.ndarray,
    b: np.ndarray,
    constraint: np.ndarray,
    *,
    slack: float = 0.0,
    matrix_noise: float = 1.0,
    data_noise: float = 1.0,
) -> np.ndarray:
    """x with |L x| <= slack that minimises |A x - b|^2 / (matrix_noise^2 |x|^2 + data_noise^2).

    Without slack the constraint has no gradient where it holds (2 L^H L x = 0), so it is eliminated: x = N z as above. With
    slack, the minimum fulfils [Golub1999]_

        (A^H A - f matrix_noise^2 I + mu L^H L) x = A^H b        f the objective, mu >= 0

    and is found as the limit of falling f [Dinkelbach1967]_: for a given f the least of |A x - b|^2 - f (matrix_noise^2 |x|^2 +
    data_noise^2) under the constraint is a trust region problem, whose global solution is known although A^H A - f I may be
    indefinite. So this is the global minimum.
    constraint : L, (rows, n), of any rank   slack : unit of L x

    Raises
    ------
    IllPosedError
        Even with L x = 0 there is no minimum, as in `total_least_squares`.
    """
    _check_noise(matrix_noise, data_noise)
    if not slack >= 0:
        raise ValueError(f"{slack=} is negative")
    A, b = np.asarray(A), np.asarray(b)
    N, P, size = _constraint_spaces(constraint)
    x = N @ total_least_squares(A @ N, b, matrix_noise=matrix_noise, data_noise=data_noise)
    if slack == 0 or not len(size):
        return np.asarray(x)

    def objective(x: np.ndarray) -> float:
        noise = matrix_noise**2 * np.vdot(x, x).real + data_noise**2
        return float(np.linalg.norm(A @ x - b) ** 2 / noise)

    # x = N z + P u / size, so that |L x| = |u|; z follows from u, and u stands in a ball
    U, s, Wh = np.linalg.svd(A @ N, full_matrices=False)
    W, outside = Wh.conj().T, A @ P / size
    shadow, own = U.conj().T @ outside, U.conj().T @ b
    least = objective(x)
    for _ in range(ROUNDS):
        f = matrix_noise**2 * least
        lift = s**2 - f
        if (
            len(s) and not lift[-1] > 0
        ):  # at the edge of having no minimum, where slack changes nothing that can be told
            break
        if len(s) < N.shape[1] and f > 0:
            break
        quadratic = outside.conj().T @ outside - np.diag(f / size**2) - shadow.conj().T @ (s**2 / lift * shadow.T).T
        linear = outside.conj().T @ b - shadow.conj().T @ (s**2 / lift * own)
        u = in_ball(quadratic, linear, slack)
        z = W @ (s / lift * (own - shadow @ u))
        trial = N @ z + P @ (u / size)
        reached = objective(trial)
        if reached > least * (1 + 1e-12):
            break
        fell = reached < least * (1 - 1e-14)
        x, least = trial, reached  # without a fall, too: x follows f to all digits, f tells only half of those of x
        if not fell:
            break
    return np.asarray(x)


def in_ball(quadratic: np.ndarray, linear: np.ndarray, radius: float) -> np.ndarray:
    """u with |u| <= radius that minimises u^H S u - 2 Re(q^H u), S of any sign  [More1983]_.

    (S + mu I) u = q with S + mu I not negative, and mu = 0 or |u| = radius: those conditions are sufficient, too.
    quadratic : S, Hermitian (n, n)   linear : q, (n,)   returns (n,)
    """
    d, V = np.linalg.eigh((quadratic + quadratic.conj().T) / 2)
    q = V.conj().T @ linear
    size = np.abs(q)
    low = max(0.0, float(np.max(size / radius - d)), -float(d[0]))
    high = max(low, float(np.linalg.norm(size)) / radius - float(d[0]))

    def inner(mu: float) -> np.ndarray:
        below = d + mu
        return np.divide(q, below, out=np.zeros_like(q), where=below > 0)

    if np.linalg.norm(inner(low)) > radius:
        for _ in range(200):  # 1/|u| is nearly a straight line in mu, so that Newton's steps on it are few
            u = inner(low)
            norm = float(np.linalg.norm(u))
            if norm <= radius * (1 + 1e-14):
                break
            slope = float(np.sum(np.abs(u) ** 2 / (d + low)))
            step = (norm / radius - 1) * norm**2 / slope
            if not step > 1e-16 * high:
                break
            low = min(low + step, high)
    u = inner(low)
    short = radius**2 - float(np.linalg.norm(u)) ** 2
    if low > 0 and low <= -d[0] and short > 0:  # q has nothing along the lowest curvature: both ways are as good
        u[0] += np.sqrt(short)
    return np.asarray(V @ u)


def _check_noise(matrix_noise: float, data_noise: float) -> None:
    if not (matrix_noise >= 0 and data_noise > 0):
        raise ValueError(f"{matrix_noise=} is negative or {data_noise=} is not positive")


def _constraint_spaces(constraint: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Orthonormal bases of the null space of L and of the rest, N (n, n - r) and P (n, r), and |L P_i|, (r,)."""
    L = np.atleast_2d(np.asarray(constraint))
    _, s, Vh = np.linalg.svd(L)
    rank = int(np.count_nonzero(s > RANK * s[0])) if len(s) and s[0] > 0 else 0
    V = Vh.conj().T
    return V[:, rank:], V[:, :rank], s[:rank]


SOLVERS = {
    "ls": least_squares,
    "tls": total_least_squares,
    "tikhonov": tikhonov,
    "constrained-ls": constrained_least_squares,
    "rtls": constrained_total_least_squares,
}
