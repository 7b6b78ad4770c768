"""The cutting matrix tooth by tooth and turn by turn: H0 over the height in cut, at an angle or as the mean over steps."""

import numpy as np

from millcal.physics.stability.regeneration import Regeneration, h0


def integral(angle, ktc, krc):
    """Integral of H0 from angle 0.   angle : (...,) rad   returns (..., 2, 2) N rad/m^2"""
    double = 2 * angle
    s, ss, cc = (1 - np.cos(double)) / 4, angle / 2 - np.sin(double) / 4, angle / 2 + np.sin(double) / 4
    return _assembled(s, ss, cc, ktc, krc)


def integral_of_integral(angle, ktc, krc):
    """Integral of `integral` from angle 0.   angle : (...,) rad   returns (..., 2, 2) N rad^2/m^2"""
    double = 2 * angle
    s = angle / 4 - np.sin(double) / 8
    ss, cc = angle**2 / 4 - (1 - np.cos(double)) / 8, angle**2 / 4 + (1 - np.cos(double)) / 8
    return _assembled(s, ss, cc, ktc, krc)


def _assembled(s, ss, cc, ktc, krc):
    along_x = np.stack([ktc * s + krc * ss, ktc * cc + krc * s], axis=-1)
    along_y = np.stack([krc * s - ktc * ss, krc * cc - ktc * s], axis=-1)
    return np.stack([along_x, along_y], axis=-2)


def pitches(cut: Regeneration) -> np.ndarray:
    """From each tooth to the next, (teeth,) rad."""
    return np.full(cut.teeth, 2 * np.pi / cut.teeth) if cut.pitch is None else np.array(cut.pitch)


def lags(cut: Regeneration) -> np.ndarray:
    """How far each tooth lags behind tooth 0, (teeth,) rad: the pitches before it."""
    return np.concatenate([[0.0], np.cumsum(pitches(cut))[:-1]])


def delays(cut: Regeneration) -> np.ndarray:
    """The angle to the tooth that cut before each, (teeth,) rad: tooth k + 1 follows by pitch k."""
    return np.roll(pitches(cut), 1)


def _tooth_angles(angle, depth, cut: Regeneration) -> np.ndarray:
    """Angle of each tooth at the tip, less every whole turn after which it may be in cut.   returns (n, teeth, turn) rad"""
    turns = np.arange(-2 - int(cut.wind * depth / (2 * np.pi)), int(np.max(angle) / (2 * np.pi)) + 1)
    return np.asarray(angle, float)[:, None, None] - lags(cut)[:, None] - 2 * np.pi * turns


def at_angle(angle, depth, cut: Regeneration, ktc: float, krc: float) -> np.ndarray:
    """Matrix of each tooth.   angle : of the spindle, (n,) rad >= 0   depth : m   returns (n, teeth, 2, 2) N/m"""
    tip = _tooth_angles(angle, depth, cut)
    if cut.wind == 0.0:
        inside = (tip >= cut.entry) & (tip < cut.leave)
        return depth * (h0(tip, ktc, krc) * inside[..., None, None]).sum(axis=2)
    from_tip = integral(np.clip(tip, cut.entry, cut.leave), ktc, krc)
    to_top = integral(np.clip(tip - cut.wind * depth, cut.entry, cut.leave), ktc, krc)
    return (from_tip - to_top).sum(axis=2) / cut.wind


def mean_over_steps(edges, depth, cut: Regeneration, ktc: float, krc: float) -> np.ndarray:
    """Exact mean of `at_angle` over each step.   edges : (n + 1,) rad   returns (n, teeth, 2, 2) N/m"""
    edges = np.asarray(edges, float)
    tip = _tooth_angles(edges, depth, cut)
    if cut.wind == 0.0:
        summed = depth * integral(np.clip(tip, cut.entry, cut.leave), ktc, krc)
    else:
        summed = (_extended(tip, cut, ktc, krc) - _extended(tip - cut.wind * depth, cut, ktc, krc)) / cut.wind
    return np.diff(summed, axis=0).sum(axis=2) / np.diff(edges)[:, None, None, None]


def _extended(angle, cut, ktc, krc):
    """Integral of `integral(clip(angle))`: straight on outside the engagement."""
    inside = np.clip(angle, cut.entry, cut.leave)
    return integral_of_integral(inside, ktc, krc) + integral(inside, ktc, krc) * (angle - inside)[..., None, None]


def real_form(tip) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (2 m, 2 m), B (2 m, 2), C (2, 2 m) of x' = A x + B F, r = C x: real and imaginary parts of the modes' states."""
    modes = len(tip.pole)
    a, b, c = np.zeros((2 * modes, 2 * modes)), np.zeros((2 * modes, 2)), np.zeros((2, 2 * modes))
    for i, s in enumerate(tip.pole):
        a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[s.real, -s.imag], [s.imag, s.real]]
        b[2 * i : 2 * i + 2] = tip.given[i].real, tip.given[i].imag
        c[:, 2 * i], c[:, 2 * i + 1] = 2 * tip.output[i].real, -2 * tip.output[i].imag
    return a, b, c
