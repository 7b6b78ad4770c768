"""Fitted modes made by hand, as the modal fit gives them: many FRFs, one FRF without hits, a record cut off too early."""

from dataclasses import dataclass

import numpy as np

from millcal.data import ModalFit, Modes, Notice

DOFS = ("tipX", "tipY", "tipZ", "noseX", "noseY", "holderX")
FREQUENCY = np.array([640.0, 668.0, 1180.0, 1505.0, 2110.0])
DAMPING = np.array([0.031, 0.027, 0.018, 0.012, 0.01])
SHAPES = np.array(  # 1/sqrt(kg)
    [
        [1.0, 0.12, 0.02, 0.62, 0.08, 0.35],
        [-0.1, 0.95, 0.03, -0.05, 0.6, 0.02],
        [0.7, -0.25, 0.1, -0.3, 0.12, -0.45],
        [0.2, 0.8, -0.05, -0.1, -0.4, 0.1],
        [0.6, 0.2, 0.3, -0.5, 0.1, 0.4],
    ]
)


@dataclass(frozen=True)
class Structure:
    """Poles and residues, and what they give in the form of acceleration over force."""

    frequency: np.ndarray  # (mode,) Hz
    damping: np.ndarray  # (mode,)
    residue: np.ndarray  # (mode, output, input), complex

    def accelerance(self, frequency: np.ndarray, length: float = np.inf) -> np.ndarray:
        """Of a hit that lasts no time; with a length, in s, what a record of that length shows of it."""
        s = 2j * np.pi * frequency[:, np.newaxis, np.newaxis]
        own = 2 * np.pi * self.frequency
        total = np.zeros((len(frequency), *self.residue.shape[1:]), complex)
        for pole, a in zip(own * (-self.damping + 1j * np.sqrt(1 - self.damping**2)), self.residue, strict=True):
            for p, part in ((pole, a), (pole.conj(), a.conj())):
                there = 1.0 if np.isinf(length) else 1 - np.exp((p - s) * length)
                total += s**2 * part / (s - p) * there
        return total


def structure(shapes: np.ndarray = SHAPES, inputs: int = 3, damping: np.ndarray = DAMPING) -> Structure:
    """Real modes with these shapes, hit at the first dofs."""
    w_d = 2 * np.pi * FREQUENCY * np.sqrt(1 - damping**2)
    alpha = shapes[:, :, np.newaxis] * shapes[:, np.newaxis, :inputs]
    return Structure(FREQUENCY, damping, alpha / (2j * w_d[:, np.newaxis, np.newaxis]))


def shapes_alike(shapes: np.ndarray) -> np.ndarray:
    """The modal assurance criterion."""
    product = np.abs(shapes @ shapes.conj().T) ** 2
    power = np.real(np.diag(product)) ** 0.5
    return product / np.outer(power, power)


def chart_of(rng: np.random.Generator, orders: int, of: Structure) -> dict[str, np.ndarray]:
    """A stabilisation chart: each mode from the order that finds it on, and as many poles of noise."""
    rows = []
    for order in range(4, orders, 2):
        for r, (f, z) in enumerate(zip(of.frequency, of.damping, strict=True)):
            if order > 6 + 5 * r:
                spread = 3.0 / order
                rows.append(
                    (order, f * (1 + 1e-3 * spread * rng.standard_normal()), z * (1 + spread * rng.normal()), 1)
                )
        for _ in range(order // 3):
            rows.append((order, rng.uniform(320, 2980), rng.uniform(0.001, 0.1), float(rng.random() < 0.05)))
    table = np.array(rows or np.empty((0, 4)), float)
    return dict(zip(("chart_order", "chart_frequency", "chart_damping", "chart_stable"), table.T, strict=True))


def fitted(
    of: Structure,
    outputs: tuple[str, ...],
    inputs: tuple[str, ...],
    *,
    seed: int = 3,
    noise: float = 0.01,
    length: float = np.inf,
    hits: int = 12,
    orders: int = 40,
    **more,
) -> Modes:
    """What a fit of such a structure looks like.   hits : 0 where no intervals are known"""
    rng = np.random.default_rng(seed)
    lines = np.linspace(300, 3000, 600)
    modelled, synthesised = of.accelerance(lines, length), of.accelerance(lines)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape)

    size = np.median(np.abs(modelled))
    error = noise * size * (normal(*modelled.shape) + 1j * normal(*modelled.shape))
    r, o, i = of.residue.shape
    spread = noise / max(np.sqrt(hits), 1)
    residual = np.linalg.norm(error, axis=0) / np.linalg.norm(modelled + error, axis=0)
    shapes = of.residue[:, :, 0] if o > 1 else of.residue[:, 0, :]
    fit = ModalFit(
        residue=of.residue,
        remainder=np.zeros((2, o, i)),
        remainder_power=np.array([-2.0, 0.0]),
        frequency_deviation=1e-2 * spread * of.frequency * normal(hits, r),
        damping_deviation=0.3 * spread * of.damping * normal(hits, r),
        residue_deviation=spread * np.abs(of.residue[:, :1, :1]) * (normal(hits, r, o, i) + 1j * normal(hits, r, o, i)),
        dof=float(max(hits - 1, 0)),
        interval_from="jackknife" if hits else "none",
        frequency=lines,
        measured=modelled + error,
        modelled=modelled,
        synthesised=synthesised,
        residual=residual,
        residual_relative=float(np.linalg.norm(error) / np.linalg.norm(modelled + error)),
        mac=shapes_alike(shapes),
        complexity=np.abs(np.angle(np.mean(shapes**2, axis=1)) / 2 - np.pi / 4) * 0.1,
        **chart_of(rng, orders, of),
        **{
            "complex_modes": False,
            "form": "accelerance",
            "outputs": outputs,
            "inputs": inputs,
            "band": (300.0, 3000.0),
            **more,
        },
    )
    w = 2 * np.pi * of.frequency
    alpha = np.real(2j * w * np.sqrt(1 - of.damping**2) * of.residue[:, 0, 0])
    return Modes(
        natural_frequency=of.frequency,
        damping_ratio=of.damping,
        stiffness=w**2 / np.where(alpha > 0, alpha, np.nan),
        axes=tuple("xyz"[int(np.argmax(np.abs(a[: min(3, o), 0])))] for a in of.residue),
        fit=fit,
        notices=(Notice("modes-close", "modes 1 and 2 stand 28 Hz apart; their shapes are told apart by directions"),),
    )


def six_by_three() -> Modes:
    """Six accelerometers, three directions of the hammer; at tipZ one mode's constant has the wrong sign."""
    of = structure()
    residue = of.residue.copy()
    residue[1, 2, 2] *= -1
    delay = {"delay": np.array([12e-6, 0, 0, 1e-6, 0, 0]), "delay_sd": np.full(6, 2e-7)}
    return fitted(Structure(of.frequency, of.damping, residue), DOFS, DOFS[:3], **delay)


def single() -> Modes:
    """One response over one hammer: complex modes, one hit, no chart."""
    of = structure(SHAPES[:, :1], 1)
    turned = Structure(of.frequency, of.damping, of.residue * np.exp(1j * np.radians([5, -8, 20, 3, 0]))[:, None, None])
    return fitted(turned, ("tipX",), ("tipX",), hits=0, orders=0, noise=0.05, complex_modes=True)


def cut_off() -> Modes:
    """Light damping in a record of 0.157 s."""
    of = structure(damping=DAMPING / 12)
    return fitted(of, DOFS, DOFS[:3], length=0.157, noise=0.002)
