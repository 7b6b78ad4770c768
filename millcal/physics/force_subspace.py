"""Which harmonics a cutter's force can have: few coefficients stand behind many harmonics, so most of them follow from the others.

With the linear-edge law the force is F = W k, W fixed by cutter and conditions: complex harmonics of all axes in a space of as many
real dimensions as coefficients show. Whatever is measured of F must lie in it, and its complement is the constraint. Some of
the equations have a conjugate in them and cannot be written as a complex row times F; so the constraint is real, on the real and
the imaginary parts.

In a slot with an even number of four or more teeth, sin phi cos phi and sin^2 phi add up to constants: Ktc and Krc give no
alternating force, and no accelerometer shows them. `force_constraint` says by name what is not shown.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from millcal.numerics.linear_constraint import ColumnSpace, column_space, unobservable
from millcal.numerics.linear_inverse import as_real_vector
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import force_basis, linear_edge_functions

NAMES = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")  # N/m^2 and N/m
AXES = ("x", "y", "z")


class ForceConstraint(NamedTuple):
    """The equations between the harmonics of a force that hold for all coefficients."""

    rows: np.ndarray  # L_R, orthonormal, (2 line axis - rank, 2 line axis): L_R [Re F; Im F] = 0
    rank: int  # of the law
    complex_rows: int  # equations, each worth two rows, that are linear in the complex harmonics
    unobservable: tuple[tuple[str, ...], ...]  # coefficients that no line shows, alone or apart from each other
    told: np.ndarray  # those that the lines show, bool (6,)
    space: ColumnSpace  # of [Re W; Im W]


def orders_of(cutter: Cutter, harmonics: int) -> np.ndarray:
    """Harmonics of the spindle that carry force, as far as that harmonic of the tooth passing.

    Multiples of the teeth for equal pitch without runout, of the repeats of its pattern for a pitch that repeats, else all.
    returns int (order,)
    """
    repeats = 1 if cutter.runout else _repeats(cutter)
    return np.arange(repeats, harmonics * cutter.teeth + 1, repeats)


def _repeats(cutter: Cutter) -> int:
    """How often in a revolution the teeth stand as before."""
    if cutter.pitch is None:
        return cutter.teeth
    pitch = np.asarray(cutter.pitch)
    shifts = [k for k in range(1, cutter.teeth + 1) if np.allclose(pitch, np.roll(pitch, k), rtol=0, atol=1e-9)]
    return cutter.teeth // shifts[0]


def harmonic_basis(
    cutter: Cutter, conditions: CuttingConditions, orders: Sequence[int] | np.ndarray, axes: Sequence[str] = AXES
) -> np.ndarray:
    """Harmonics of the force on the tool per unit of each coefficient, at spindle angle 0 for tooth 0 at the bottom.

    One-sided, F(theta) = Re sum_n c_n exp(j n theta); the two-sided Fourier coefficient is c_n / 2. A force that is counted from
    another angle, theta - phase, has c_n exp(-j n phase), so its derivative by the phase is -j n c_n.
    orders : (line,) of the spindle   axes : of x, y, z   returns complex (line, axis, coefficient), coefficients as in NAMES
    """
    order = np.asarray(orders, int)
    basis = force_basis(linear_edge_functions, cutter, conditions, int(order.max()))  # axis, direction, function, k
    chosen = basis[[AXES.index(axis) for axis in axes]][..., order]
    cutting_first = np.moveaxis(chosen, 3, 0)[..., ::-1].swapaxes(2, 3)  # line, axis, function, direction
    return np.ascontiguousarray(cutting_first.reshape(len(order), len(axes), len(NAMES)))


def force_constraint(basis: np.ndarray) -> ForceConstraint:
    """The constraint of the force law on harmonics, of one cut or of several with the same coefficients.

    basis : complex (line, axis, coefficient), the cuts one behind the other. The harmonics that it speaks of are complex
    (line, axis) raveled, real parts before imaginary parts, as `as_real_vector` has them.
    """
    W = basis.reshape(-1, basis.shape[-1])
    space = column_space(as_real_vector(W))
    groups = tuple(tuple(NAMES[i] for i in group) for group in unobservable(space))
    hidden = {name for group in groups for name in group}
    return ForceConstraint(
        rows=space.complement.T,
        rank=space.rank,
        complex_rows=len(W) - column_space(W).rank,
        unobservable=groups,
        told=np.array([name not in hidden for name in NAMES]),
        space=space,
    )
