"""The reference reads as it says."""

import numpy as np
from structure_2012 import REFERENCE, accelerance


def test_the_accelerance_has_the_values_that_the_reference_states():
    check = REFERENCE["check"]
    np.testing.assert_allclose(np.abs(accelerance(check["f_hz"])[:, 0, 0]), check["abs_G_s1x"], rtol=1e-12)


def test_the_accelerance_is_the_formula_of_the_reference():
    f = np.array([53.0, 106.0])
    w, wm = 2 * np.pi * f[:, None], 2 * np.pi * np.array(REFERENCE["fn_hz"])
    modal = -(w**2) / (np.array(REFERENCE["mass_kg"]) * (wm**2 - w**2 + 2j * np.array(REFERENCE["zeta"]) * wm * w))
    G = np.einsum("fm,sm,dm->fsd", modal, REFERENCE["phi_sensor_mode"], REFERENCE["psi_direction_mode"])
    np.testing.assert_allclose(accelerance(f), G, rtol=1e-12)
