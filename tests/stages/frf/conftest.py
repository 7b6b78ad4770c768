"""Impact tests with known truth, small and independent of `millcal.simulation`: modes, half-sine pulses, noise, faults."""

from dataclasses import replace

import numpy as np
import pytest
from impact_cases import RATE, STRUCTURES, half_sine

from millcal.data import Channel, Recording

DOFS = ("tipX", "tipY", "headX")
SYSTEMS = {
    name: replace(STRUCTURES[name], shape=STRUCTURES[name].shape[rows], dofs=DOFS, pulse=pulse)
    for name, rows, pulse in (("A", [0, 1, 3], 2.8e-3), ("B", [0, 1, 3], 2.7e-4))
}


@pytest.fixture
def structures():
    return SYSTEMS


@pytest.fixture
def impact_test():
    """Function that makes an impact test: see `make`."""

    def make(
        rng,
        system="B",
        *,
        hits=9,
        noise=(0.002, 0.005),
        forces=("tipX",),
        responses=DOFS,
        directions=None,
        length=8192,
        seconds=None,
        second=None,
        overload=None,
        full_scale=True,
        scale=(1.0, 1.0),
        peaks=None,
        name="tap.h5",
    ):
        """A segmented recording, or a continuous one with a hit every `seconds`.

        noise : share of the largest peak, force and response   directions : (hit, force) of each hit
        second : hit -> (share, pulse lengths after the first) of a second pulse
        overload : hit -> share of the peak that is cut off by the input range of the force
        """
        structure = SYSTEMS[system]
        n = length if seconds is None else int(seconds * RATE)
        period = 4 * max(n, 8192)
        frequency = np.fft.rfftfreq(period, 1 / RATE)
        anti_alias = np.clip((0.46 * RATE - frequency) / (0.06 * RATE), 0, 1)
        H = structure.accelerance(frequency, responses, forces)
        total = hits * n + (0 if seconds is None else period)
        samples = np.zeros((len(forces) + len(responses), total))
        onsets, tops = [], []
        for hit in range(hits):
            peak = 1000.0 * rng.uniform(0.7, 1.3) if peaks is None else peaks[hit]
            duration = structure.pulse * rng.uniform(0.85, 1.15)
            onset = (160 + rng.uniform(0, 10)) / RATE + (0 if seconds is None else 0.25 * seconds * rng.uniform())
            F = half_sine(frequency, onset, duration, peak)
            if hit in (second or {}):
                share, after = second[hit]
                F = F + half_sine(frequency, onset + after * duration, duration, share * peak)
            direction = np.ones((1, 1)) if directions is None else np.asarray(directions[hit], float)[:, None]
            F = F * anti_alias * direction
            X = np.einsum("foi,if->of", H, F)
            own = np.fft.irfft(np.vstack([F, X]), period) * RATE
            if seconds is None:
                samples[:, hit * n : (hit + 1) * n] = own[:, :n]
            else:
                samples[:, hit * n : hit * n + period] += own
            onsets.append(onset if seconds is None else hit * n / RATE + onset)
            tops.append(peak)
        samples = samples[:, : hits * n]
        m = len(forces)
        size = np.array([np.abs(samples[:m]).max()] * m + [np.abs(samples[m:]).max()] * len(responses))
        samples = samples + size[:, None] * np.repeat(noise, [m, len(responses)])[:, None] * rng.standard_normal(
            samples.shape
        )
        limits = [1.3 * s for s in size]
        for hit, share in (overload or {}).items():
            limits[0] = (1 - share) * tops[hit]
        if max(noise) > 0:
            count = np.array(limits)[:, None] / 32768
            samples = np.clip(np.round(samples / count), -32768, 32767) * count
        samples *= np.array([scale[0]] * m + [scale[1]] * len(responses))[:, None]
        limits = [own * k for own, k in zip(limits, [scale[0]] * m + [scale[1]] * len(responses), strict=True)]
        dofs = (*forces, *responses)
        channels = tuple(
            Channel(
                ("hammer_" if row < m else "acc_") + dof,
                "force" if row < m else "acceleration",
                "N" if row < m else "m/s^2",
                dof,
                limits[row] if full_scale else None,
            )
            for row, dof in enumerate(dofs)
        )
        recording = Recording(
            samples=samples,
            sample_rate=RATE,
            channels=channels,
            kind="impact",
            name=name,
            segments=None if seconds else np.array([[hit * n, n] for hit in range(hits)]),
        )
        return recording, np.array(onsets)

    return make


@pytest.fixture
def relative_error():
    """Function: norm of the error of an FRF in a band over the norm of the truth, both as receptance."""

    def error(frf, truth, band):
        inside = (frf.frequency >= band[0]) & (frf.frequency <= band[1])
        frequency = frf.frequency[inside]
        expected = truth(frequency, frf.outputs, frf.inputs)
        power = {"receptance": 0, "mobility": 1, "accelerance": 2}[frf.form]
        found = frf.values[inside] / ((2j * np.pi * frequency) ** power)[:, None, None]
        return np.linalg.norm(found - expected) / np.linalg.norm(expected)

    return error
