"""Cuts with known truth, as harmonics: what conditioning would hand over for a record of known noise."""

from collections.abc import Callable

import numpy as np
import pytest

from millcal.data import CutForce
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import force_at, force_harmonics

SAVED = 12
SPINDLE_HZ = 100.0


def cut_of(
    law,
    cutter: Cutter,
    conditions: CuttingConditions,
    *,
    phase: float,
    scatter: float = 0.0,
    rng: np.random.Generator | None = None,
) -> CutForce:
    """A conditioned cut of a law; `scatter` is the standard deviation of the error of its mean forces and harmonics, N."""
    harmonics = force_harmonics(law, cutter, conditions, SAVED) * np.exp(1j * np.arange(SAVED + 1) * phase)
    if rng is not None:
        noise = rng.standard_normal((2, *harmonics.shape)) * scatter
        harmonics = harmonics + noise[0] + 1j * np.where(np.arange(SAVED + 1) > 0, noise[1], 0.0)
    angle = 2 * np.pi * np.arange(90) / 90
    mean, flat = harmonics[:, 0].real, np.zeros((3, 2))
    return CutForce(
        name=f"fz{conditions.feed_per_tooth * 1e3:.3f}",
        cutter=cutter,
        conditions=conditions,
        harmonics=harmonics,
        harmonics_variance=np.full(harmonics.shape, 2 * max(scatter, 1e-9) ** 2),
        mean_all_rows=mean,
        revolution_means=np.repeat(mean[:, np.newaxis], 20, axis=1),
        average_angle=angle,
        average=force_at(harmonics, angle),
        scatter=np.zeros((3, len(angle))),
        ac_rms=np.sqrt(np.sum(np.abs(harmonics[:, 1:]) ** 2, axis=1) / 2),
        asynchronous_rms=np.zeros(3),
        overview_time=np.array([0.0, 1.0]),
        overview_low=flat,
        overview_high=flat,
        removed_offset=np.zeros(3),
        removed_drift=np.zeros(3),
        sample_rate=10_000.0,
        spindle_frequency=SPINDLE_HZ,
        spindle_frequency_sd=1e-4,
        revolutions=100,
        steady=(0.0, 1.0),
        air=((-0.5, -0.1),),
    )


@pytest.fixture
def series() -> Callable[..., tuple[CutForce, ...]]:
    """series(law, cutter, feeds_mm, ...) -> cuts at several feeds with unrelated phases."""

    def make(
        law,
        cutter,
        feeds_mm=(0.04, 0.06, 0.08, 0.1, 0.12),
        *,
        scatter=0.0,
        seed=0,
        direction="slot",
        radial=None,
        depth=3e-3,
    ):
        rng = np.random.default_rng(seed)
        cuts = []
        for feed in feeds_mm:
            conditions = CuttingConditions(
                spindle_speed=2 * np.pi * SPINDLE_HZ,
                feed_per_tooth=feed * 1e-3,
                axial_depth=depth,
                radial_depth=radial or cutter.diameter,
                direction=direction,
            )
            phase = rng.uniform(0, 2 * np.pi)
            cuts.append(cut_of(law, cutter, conditions, phase=phase, scatter=scatter, rng=rng if scatter else None))
        return tuple(cuts)

    return make
