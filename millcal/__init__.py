"""Calibrate milling models offline, from recorded files: FRF, cutting forces, coefficients, stability."""

__version__ = "0.1.0"
