"""A linear difference equation sample by sample, compiled, for loops in which what goes in depends on what came out.

    a_0 y_k = b_0 x_k + b_1 x_(k-1) + ... - a_1 y_(k-1) - ...

This module imports numba and so is imported where it is used; for `STAMP` see `millcal.numerics.interacting_kernel`.
"""

import hashlib
import inspect
import sys

import numpy as np
from numba import njit

STAMP = int(hashlib.sha256(inspect.getsource(sys.modules[__name__]).encode()).hexdigest()[:15], 16)


def padded(filter_: tuple[np.ndarray, np.ndarray] | None) -> tuple[np.ndarray, np.ndarray]:
    """b and a of one length and with a_0 = 1; those of no filter where there is none.   returns two of (order + 1,)"""
    b, a = (np.ones(1), np.ones(1)) if filter_ is None else (np.asarray(c, float) for c in filter_)
    length = max(len(a), len(b))
    return np.pad(b / a[0], (0, length - len(b))), np.pad(a / a[0], (0, length - len(a)))


@njit(cache=True)
def filter_sample(value, b, a, memory):  # type: ignore[no-untyped-def]
    """One sample through a filter in the transposed second form, as scipy's lfilter; `memory` (order,) is carried on."""
    order = memory.size
    out = b[0] * value
    if order:
        out += memory[0]
        for i in range(order - 1):
            memory[i] = b[i + 1] * value + memory[i + 1] - a[i + 1] * out
        memory[order - 1] = b[order] * value - a[order] * out
    return out
