"""Impact tests with known truth, of fourteen kinds, from any seed: what the estimates and their peers are measured on.

A kind is a structure, a level of noise and what happens to the hits. Everything is made from its formula, independent of
`millcal.simulation`: half-sine forces by their exact Fourier integral, responses as the exact accelerance times that, both
through one anti-alias filter, so that no discretisation stands between the samples and the truth. Noise is a share of the
largest force of the test, and of the median over the hits of the largest value of each accelerometer; the channels carry an
offset and are counts of an int16 converter, except in the two kinds without noise.

The tests find this folder by `pythonpath` in pyproject.toml, the benchmark by its own path.
"""

from dataclasses import dataclass, field

import numpy as np

from millcal.data import Channel, Recording

RATE = 25600.0  # Hz
HAMMER = ("tipX", "tipY", "tipZ")
OFFSET = (0.003, 0.002, -0.002, 0.001, 0.002, -0.0014, 0.0006)  # of the hammer's and the accelerometers' sizes


@dataclass(frozen=True)
class Structure:
    """Modes, and the pulses that excite them."""

    natural_frequency: np.ndarray  # (mode,) Hz
    damping_ratio: np.ndarray
    shape: np.ndarray  # (dof, mode), mass-normalised
    dofs: tuple[str, ...]
    pulse: float  # s
    pulse_spread: float  # share by which it may be shorter or longer
    peak: tuple[float, float]  # N
    band: tuple[float, float]  # Hz, where errors are judged

    def receptance(self, frequency, outputs, inputs):
        """frequency : (f,) Hz   returns complex (f, output, input) m/N"""
        w, wn = 2 * np.pi * np.asarray(frequency), 2 * np.pi * self.natural_frequency
        poles = 1 / (wn**2 - w[:, None] ** 2 + 2j * self.damping_ratio * wn * w[:, None])
        o, i = (self.shape[[self.dofs.index(dof) for dof in names]] for names in (outputs, inputs))
        return np.einsum("om,im,fm->foi", o, i, poles)

    def accelerance(self, frequency, outputs, inputs):
        """frequency : (f,) Hz   returns complex (f, output, input) m/s^2/N"""
        return -((2 * np.pi * np.asarray(frequency)) ** 2)[:, None, None] * self.receptance(frequency, outputs, inputs)

    @property
    def in_band(self) -> np.ndarray:
        """Indices of the modes within the band."""
        low, high = self.band
        return np.flatnonzero((self.natural_frequency > low) & (self.natural_frequency < high))

    def modal_constants(self, outputs, inputs):
        """phi_o phi_i of the modes within the band.   returns (mode, output, input) 1/kg"""
        o, i = (self.shape[[self.dofs.index(dof) for dof in names]][:, self.in_band] for names in (outputs, inputs))
        return np.einsum("om,im->moi", o, i)


_MACHINE = np.array(
    [
        [0.08, 0.06, -0.055],
        [0.035, 0.095, 0.05],
        [-0.02, 0.03, 0.085],
        [0.06, 0.02, -0.07],
        [0.025, 0.07, 0.03],
        [0.045, -0.04, 0.02],
    ]
)
_TOOL = np.array(
    [
        [0.9, 0.6, 2.2],
        [0.35, 2.1, -0.9],
        [0.12, -0.25, 0.3],
        [0.55, 0.25, -0.8],
        [0.2, 0.95, 0.45],
        [0.3, -0.1, 0.15],
    ]
)
_BELOW = np.array([[0.12, 0.1, 0.05, 0.12, 0.1, 0.11]]).T
_ABOVE = np.array([[2.1, -1.7, 0.6, 1.3, -1.0, 0.7]]).T
_TOOL_DOFS = (*HAMMER, "holdX", "holdY", "noseX")
_SHORT = {"dofs": _TOOL_DOFS, "pulse": 2.55e-4, "pulse_spread": 0.137, "peak": (190.0, 385.0), "band": (300.0, 3000.0)}


def _structure(natural_frequency, damping_ratio, shape, **rest):
    return Structure(np.array(natural_frequency), np.array(damping_ratio), shape, **rest)


STRUCTURES = {
    "A": _structure(
        [60.0, 82.0, 103.0],
        [0.10, 0.15, 0.07],
        _MACHINE,
        dofs=(*HAMMER, "headX", "headY", "colX"),
        pulse=3.075e-3,
        pulse_spread=0.17,
        peak=(1200.0, 2600.0),
        band=(30.0, 200.0),
    ),
    "B": _structure([650.0, 1200.0, 2100.0], [0.03, 0.018, 0.01], _TOOL, **_SHORT),
    "C": _structure([650.0, 1200.0, 2100.0], [0.002, 0.0015, 0.003], _TOOL, **_SHORT),
    "D": _structure([640.0, 668.0, 1500.0], [0.015, 0.015, 0.01], _TOOL, **_SHORT),
    "R": _structure(
        [38.0, 650.0, 1200.0, 2100.0, 6900.0],
        [0.05, 0.03, 0.018, 0.01, 0.02],
        np.hstack([_BELOW, _TOOL, _ABOVE]),
        **_SHORT,
    ),
}


@dataclass(frozen=True)
class Kind:
    """What is recorded."""

    structure: str
    noise: tuple[float, float]  # rms, share of the size of force and acceleration
    hits: int = 9  # per recording
    length: int = 8192  # samples of a hit's record
    recordings: tuple[str, ...] = HAMMER  # the hammer's direction in each
    oblique: bool = False  # one recording with three force channels
    continuous: bool = False
    doubles: dict[int, tuple[float, float]] = field(default_factory=dict)  # hit -> (share, s after the first)
    weak: tuple[int, ...] = ()
    force_overloads: tuple[int, ...] = ()
    response_overloads: tuple[int, ...] = ()


LOW, MEDIUM, HIGH = (2e-4, 5e-4), (2e-3, 5e-3), (1e-2, 2e-2)
_ONE = {"recordings": HAMMER[:1]}
_CONTINUOUS = {"hits": 14, "continuous": True, "weak": (5,), "force_overloads": (7, 12), **_ONE}

KINDS = {
    "01_exact_A": Kind("A", (0.0, 0.0), hits=1),
    "02_exact_B": Kind("B", (0.0, 0.0), hits=1),
    "03_B_low": Kind("B", LOW),
    "04_B_med": Kind("B", MEDIUM),
    "05_B_high": Kind("B", HIGH),
    "06_A_med": Kind("A", MEDIUM),
    "07_A_high": Kind("A", HIGH),
    "08_D_low": Kind("D", LOW),
    "09_R_low": Kind("R", LOW),
    "10_C_light": Kind("C", LOW, length=4019),
    "11_B_oblique3": Kind("B", MEDIUM, hits=12, oblique=True, **_ONE),
    "12_B_badhits": Kind(
        "B",
        LOW,
        hits=13,
        doubles={2: (0.45, 12e-3), 8: (0.26, 4.5e-3), 11: (0.13, 1.6e-3)},
        force_overloads=(5,),
        response_overloads=(10,),
        **_ONE,
    ),
    "13_B_continuous": Kind("B", (3e-4, 5e-4), doubles={2: (0.4, 1.3e-3), 9: (0.2, 4e-3)}, **_CONTINUOUS),
    "14_A_continuous": Kind("A", (3e-4, 5e-4), doubles={2: (0.4, 15e-3), 9: (0.2, 36e-3)}, **_CONTINUOUS),
}


@dataclass(frozen=True)
class Case:
    """Recordings and what is true of them."""

    name: str
    recordings: tuple[Recording, ...]
    structure: Structure
    labels: tuple[str, ...]  # of every hit: good, double, weak, clip_force, clip_acc
    onset: np.ndarray  # (hit,) s, in its recording

    @property
    def good(self) -> list[list[int]]:
        """The good hits of each recording, from 0."""
        per = len(self.labels) // len(self.recordings)
        return [
            [hit for hit in range(per) if self.labels[n * per + hit] == "good"] for n in range(len(self.recordings))
        ]


def half_sine(frequency, start, length, peak):
    """Fourier integral of a half-sine pulse.   frequency : (f,) Hz   returns complex (f,) N s"""
    w = 2 * np.pi * frequency * length
    safe = np.where(np.isclose(w, np.pi), np.pi * (1 + 1e-6), w)
    spectrum = np.pi / (np.pi**2 - safe**2) * (1 + np.exp(-1j * safe))
    return peak * length * spectrum * np.exp(-2j * np.pi * frequency * start)


def anti_alias(frequency, rate=RATE):
    """Gain of the converters' filter, a raised cosine from 0.42 to 0.5 of the sampling rate."""
    x = np.clip((frequency / rate - 0.42) / 0.08, 0, 1)
    return np.cos(0.5 * np.pi * x) ** 2


def make_case(name: str, seed: int) -> Case:
    """A case of a kind, with pulses and noise of its own for each seed."""
    kind = KINDS[name]
    structure = STRUCTURES[kind.structure]
    rng = np.random.default_rng([list(KINDS).index(name), seed])
    labels = np.full(kind.hits, "good", dtype="<U10")
    for label, which in {
        "double": kind.doubles,
        "weak": kind.weak,
        "clip_force": kind.force_overloads,
        "clip_acc": kind.response_overloads,
    }.items():
        labels[list(which)] = label

    inputs = HAMMER if kind.oblique else None
    clean, onsets, forces = [], [], []
    for direction in kind.recordings:
        dofs = inputs or (direction,)
        onset = rng.uniform(6.1e-3, 6.7e-3, kind.hits)
        if kind.continuous:
            onset = 0.35 + np.cumsum(np.r_[0.0, rng.uniform(0.55, 0.92, kind.hits - 1)])
        duration = structure.pulse * (1 + structure.pulse_spread * rng.uniform(-1, 1, kind.hits))
        peak = rng.uniform(*structure.peak, kind.hits)
        peak[list(kind.weak)] *= 0.035
        largest = peak[labels == "good"].max()
        peak[labels == "clip_force"] = largest * rng.uniform(
            1.5 if kind.continuous else 1.7, 1.8, len(kind.force_overloads)
        )
        peak[labels == "clip_acc"] = 1.3 * largest
        duration[labels == "clip_acc"] = structure.pulse * (1 + structure.pulse_spread)
        across = np.ones((kind.hits, 1))
        if kind.oblique:
            across = _oblique(rng, kind.hits)
        samples = _samples(kind, structure, dofs, onset, duration, peak, across)
        clean.append(samples)
        onsets.append(onset)
        forces.append(dofs)

    sizes = _sizes(kind, clean)
    ranges = _ranges(kind, clean, labels, largest)
    recordings = tuple(
        _recorded(rng, kind, structure, samples, dofs, sizes, ranges, f"tap_{'' if inputs else direction}.h5")
        for samples, dofs, direction in zip(clean, forces, kind.recordings, strict=True)
    )
    return Case(name, recordings, structure, tuple(map(str, labels)) * len(recordings), np.concatenate(onsets))


def _oblique(rng, hits):
    """Directions of oblique hits, mostly along each axis in turn.   returns (hit, 3) unit vectors"""
    across = np.eye(3)[np.arange(hits) % 3] + rng.uniform(-0.4, 0.4, (hits, 3))
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def _samples(kind, structure, dofs, onset, duration, peak, across):
    """Force and acceleration without noise.   returns (hit, channel, sample), or one long "hit" """
    slowest = 2 * np.pi * np.min(structure.natural_frequency * structure.damping_ratio)
    length = round((onset[-1] + 1.0) * RATE) if kind.continuous else kind.length
    left = 32 if max(kind.noise) == 0 else 19  # e-folds of the slowest mode until it comes round again
    period = 1 << int(np.ceil(np.log2(length + left / slowest * RATE)))
    frequency = np.fft.rfftfreq(period, 1 / RATE)
    F = np.stack([half_sine(frequency, *row) for row in zip(onset, duration, peak, strict=True)])
    for hit, (share, after) in kind.doubles.items():
        F[hit] += half_sine(frequency, onset[hit] + after, duration[hit], share * peak[hit])
    F = (F * anti_alias(frequency))[:, None] * across[:, :, None]  # (hit, force, line)
    if kind.continuous:
        F = F.sum(axis=0, keepdims=True)
    X = np.einsum("foi,hif->hof", structure.accelerance(frequency, structure.dofs, dofs), F)
    return np.fft.irfft(np.concatenate([F, X], axis=1), period)[:, :, :length] * RATE


def _sizes(kind, clean):
    """What the shares of the noise are shares of.   returns (channel,)"""
    largest = np.concatenate([np.abs(samples).max(axis=2) for samples in clean])  # (hit, channel)
    m = 3 if kind.oblique else 1
    return np.r_[np.full(m, largest[:, :m].max()), np.median(largest[:, m:], axis=0)]


def _ranges(kind, clean, labels, largest):
    """Input ranges of the hammer and of the accelerometers, above the largest good hit.   returns (2,)"""
    m = 3 if kind.oblique else 1
    if kind.continuous:  # the hammer alone overloads
        return np.array([1.2 * largest, 1.25 * np.abs(clean[0][:, m:]).max()])
    good = np.concatenate([np.abs(samples[labels == "good"]).max(axis=2) for samples in clean])
    hammer, accelerometer = (1.45, 1.12) if kind.response_overloads else (1.25, 1.25)
    return np.array([hammer * good[:, :m].max(), accelerometer * good[:, m:].max()])


def _recorded(rng, kind, structure, clean, inputs, sizes, ranges, name):
    """The recording of clean samples: offset, noise and counts, hits one behind the other."""
    hits, rows, length = clean.shape
    m = len(inputs)
    samples = np.ascontiguousarray(clean.transpose(1, 0, 2).reshape(rows, hits * length))
    full_scale = np.repeat(ranges, [m, rows - m])
    if max(kind.noise) > 0:
        offset = sizes * np.r_[np.full(m, OFFSET[0]), OFFSET[1:]]
        rms = sizes * np.repeat(kind.noise, [m, rows - m])
        samples += offset[:, None] + rms[:, None] * rng.standard_normal(samples.shape)
        count = full_scale[:, None] / 32767
        samples = np.clip(np.round(samples / count), -32767, 32767) * count
    names = [f"hammer_{dof}" for dof in inputs] + [f"acc_{dof}" for dof in structure.dofs]
    channels = tuple(
        Channel(
            channel,
            "force" if row < m else "acceleration",
            "N" if row < m else "m/s^2",
            channel.split("_")[1],
            full_scale[row] if max(kind.noise) > 0 else None,
        )
        for row, channel in enumerate(names)
    )
    return Recording(
        samples=samples,
        sample_rate=RATE,
        channels=channels,
        kind="impact",
        name=name,
        segments=None if kind.continuous else np.array([[hit * length, length] for hit in range(hits)]),
    )
