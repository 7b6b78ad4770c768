"""The torque that a cut asks of the spindle, on the mean over a revolution, and its power.

The tangential force of every edge turns about the axis at the radius, so torque = R sum_j F_t,j. Its mean comes from the
exact force model, harmonic 0 of the tangential force: runout and curved laws included. For the linear-edge law and no runout

    T = R N b / (2 pi) [K_tc f_z (cos entry - cos leave) + K_te (leave - entry)],

whatever helix and pitch: every chip is cut once in a revolution.
"""

import numpy as np

from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import (
    ChipFunctions,
    Kienzle,
    LinearEdge,
    force_basis,
    kienzle_functions,
    linear_edge_functions,
)


def mean_torque(law: LinearEdge | Kienzle, cutter: Cutter, conditions: CuttingConditions) -> float:
    """N m, mean over a revolution.

    References
    ----------
    Altintas, Manufacturing Automation, 2nd ed., eqs. 2.8 and 2.28: T = D/2 sum F_t.
    """
    functions: ChipFunctions
    if isinstance(law, LinearEdge):
        functions, weight = linear_edge_functions, np.array([law.edge[0], law.cutting[0]])
    else:
        functions, weight = kienzle_functions(law.rise[:1]), law.specific_force[:1]
    axial = force_basis(functions, cutter, conditions, 0)[
        2, 2, :, 0
    ].real  # sum of g(h) over edges, as the axial force is
    return float(cutter.radius * axial @ weight)
