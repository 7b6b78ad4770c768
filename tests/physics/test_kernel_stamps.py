"""Compiled loops are kept under a key that knows the source of what they call in other modules."""

import pytest

from millcal.numerics import difference_kernel, interacting_kernel
from millcal.physics import edge_kernel, follow_imm, follow_rls


@pytest.mark.parametrize(
    ("loop", "called"),
    [
        (follow_imm._loop, (edge_kernel, difference_kernel, interacting_kernel)),
        (follow_rls._loop, (edge_kernel, difference_kernel)),
    ],
    ids=["imm", "rls"],
)
def test_a_loop_encloses_the_stamps_of_what_it_calls(loop, called):
    """numba hashes the variables around a function into the key of its cache, and not what its callees were made of."""
    enclosed = [cell.cell_contents for cell in loop.py_func.__closure__]
    assert any(
        set(module.STAMP for module in called) <= set(stamps) for stamps in enclosed if isinstance(stamps, tuple)
    )
    homes = {value.py_func.__module__ for value in loop.py_func.__globals__.values() if hasattr(value, "py_func")}
    assert homes <= {module.__name__ for module in called} | {loop.py_func.__module__}
