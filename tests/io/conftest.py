"""One record of each kind with awkward content: nan, infinity, None, complex numbers, empty tuples, foreign letters."""

import numpy as np
import pytest

from millcal.data import (
    AsynchronousPeak,
    BestSpeed,
    Check,
    Coefficients,
    CutForce,
    CutTests,
    Frf,
    Hit,
    Modes,
    Notice,
    OperatingPoint,
    Posterior,
    SimulatedCuts,
    StabilityMap,
)
from millcal.physics.cutter import Cutter, CuttingConditions

CUTTER = Cutter(diameter=25e-3, teeth=2, helix=0.7854, pitch=(3.0, 2 * np.pi - 3.0))
CONDITIONS = CuttingConditions(628.3, 1e-4, 3e-3, 25e-3, "slot")


def cut(rng, name="cut µ.csv"):
    def real(*shape):
        return rng.standard_normal(shape)

    return CutForce(
        name=name, cutter=CUTTER, conditions=CONDITIONS,
        harmonics=real(3, 5) + 1j * real(3, 5), harmonics_variance=real(3, 5) ** 2, mean_all_rows=real(3),
        revolution_means=real(3, 7), average_angle=real(16), average=real(3, 16), scatter=np.full((3, 16), np.nan),
        ac_rms=1 + real(3) ** 2, asynchronous_rms=real(3), overview_time=real(9), overview_low=real(3, 9),
        overview_high=real(3, 9), removed_offset=real(3), removed_drift=real(3), sample_rate=1e4,
        spindle_frequency=99.99, spindle_frequency_sd=np.nan, revolutions=7, steady=(0.1, 0.9),
        air=((0.0, 0.05), (0.95, 1.0)), peaks=(AsynchronousPeak("x", 975.0, 9.4, np.inf),),
        notices=(Notice("no-air", "a word; é", "cut"),),
    )  # fmt: skip


def frf(rng, n=40, optional=True):
    values = rng.standard_normal((n, 2, 1)) + 1j * rng.standard_normal((n, 2, 1))
    return Frf(
        frequency=np.arange(n, dtype=float), values=values,
        coherence=np.full((n, 2, 1), np.nan) if optional else None,
        variance=np.abs(values) if optional else None, form="receptance", estimator="h1", outputs=("tipX", "tipY"),
        inputs=("tipX",), hits_used=(5,), usable_band=(20.0, np.inf),
        hits=(Hit("a.h5", 0, 0.1, 250.0, False, ("double",)), Hit("a.h5", 1, np.nan, 250.0, True)),
    )  # fmt: skip


def coefficients(rng):
    n = 3
    posterior = Posterior(
        names=("Ktc", "Krc"), units=("N/m^2", "N/m^2"), mean=np.array([9e8, 2e8]), covariance=np.eye(2),
        interval=np.array([[8e8, 1e9], [1e8, np.inf]]), law="linear-edge", method="average",
    )  # fmt: skip
    return Coefficients(
        posterior=posterior, cutter=CUTTER, conditions=(CONDITIONS,) * n, cuts=("a", "b", "c"), verdict="fits",
        checks=(Check("signs", True, "fine"),), feed_per_tooth=rng.random(n), measured_mean=rng.random((n, 3)),
        modelled_mean=rng.random((n, 3)), angle=rng.random(8), measured=rng.random((n, 3, 8)),
        modelled=rng.random((n, 3, 8)), measured_amplitude=rng.random((n, 3, 4)),
        modelled_amplitude=rng.random((n, 3, 4)), residual_rms=rng.random(3), r2=rng.random(3), band=(0, 6),
        alternatives=(("kienzle", (("r2", 0.5), ("bic", np.nan))),),
    )  # fmt: skip


def stability_map(rng):
    return StabilityMap(
        spindle_speed=np.linspace(500.0, 1000.0, 6), limit_depth=np.array([np.inf, 2e-3, 1e-3, 1.5e-3, 3e-3, np.inf]),
        chatter_frequency=np.array([np.nan, 800.0, 810.0, 405.0, 820.0, np.nan]),
        limit_kind=np.array([-1.0, 0.0, 0.0, 1.0, 0.0, -1.0]), lobe=np.array([-1.0, 2.0, 2.0, 1.0, 1.0, -1.0]),
        crossing_speed=np.array([600.0, 700.0, 800.0, 800.0, 800.0, 900.0]),
        crossing_depth=np.array([2e-3, 1e-3, 1.5e-3, 1.8e-3, 2.5e-3, 3e-3]),
        crossing_kind=np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]),
        crossing_frequency=np.array([800.0, 810.0, 405.0, 406.0, 815.0, np.nan]),
        crossing_loses=np.array([1.0, 1.0, 1.0, 0.0, 1.0, 1.0]), probability=rng.random((4, 6)),
        probability_depth=np.linspace(0.0, 3e-3, 4), method="floquet", deepest=4e-3, teeth=2, radial_depth=1e-2,
        diameter=25e-3, direction="down", feed_per_tooth=None, absolute_minimum=1e-3, absolute_minimum_frequency=810.0,
        best=(BestSpeed(600.0, 2e-3, 1e-6, None),),
        operating=OperatingPoint(700.0, 1.2e-3, 1e-3, False, "hopf", 810.0, (8e-4, np.inf), 0.1, (np.inf, 30.0), ("less µ",)),
        tests=CutTests(
            spindle_speed=np.array([600.0, 800.0]), axial_depth=np.array([1e-3, 1.6e-3]), stable=np.array([1.0, 1.0]),
            stable_by_map=np.array([1.0, 0.0]), name="cuts é.csv",
        ),
        simulated=SimulatedCuts(
            spindle_speed=np.array([600.0, 800.0, 800.0]), axial_depth=np.array([1e-3, 1.6e-3, 2.6e-3]),
            period=np.array([1.0, 2.0, 0.0]), metric=np.array([1e-9, 5e-6, np.nan]),
        ),
    )  # fmt: skip


def modes(_rng):
    return Modes(
        natural_frequency=np.array([900.0]), damping_ratio=np.array([0.01]), stiffness=np.array([1e7]), axes=("x",)
    )


def history(_rng):
    from histories import unknown  # here, for a test runs this file without the folder of the generators

    return unknown()


MAKERS = {maker.__name__: maker for maker in (cut, frf, coefficients, history, stability_map, modes)}


@pytest.fixture(params=MAKERS)
def record(request):
    """Each kind of record in turn."""
    return MAKERS[request.param](np.random.default_rng(1))


@pytest.fixture
def make_record():
    """make_record("frf", seed=1, n=40)"""
    return lambda kind, seed=1, **more: MAKERS[kind](np.random.default_rng(seed), **more)
