"""Records as the stages make them, from the physics and a little noise: a slot series, an impact test, a map."""

import numpy as np
import pytest

from millcal.data import (
    AsynchronousPeak,
    BestSpeed,
    Check,
    Coefficients,
    CutForce,
    Frf,
    Hit,
    Notice,
    OperatingPoint,
    Posterior,
    StabilityMap,
)
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import LinearEdge, force_at, force_harmonics

CUTTER = Cutter(diameter=0.025, teeth=2, helix=np.pi / 4, runout=11e-6)
LAW = LinearEdge(np.array([893e6, 163e6, 26e6]), np.array([21.5e3, 27.1e3, 28.2e3]))
FEEDS = (0.025e-3, 0.05e-3, 0.075e-3, 0.1e-3, 0.125e-3)
SPEED = 6000 * 2 * np.pi / 60


def slot(feed_per_tooth: float) -> CuttingConditions:
    return CuttingConditions(SPEED, feed_per_tooth, 3e-3, 25e-3, "slot")


def cut_force(number: int, rng: np.random.Generator) -> CutForce:
    """A conditioned slot cut whose harmonics above tooth passing grow beyond the model's."""
    conditions = slot(FEEDS[number])
    harmonics = force_harmonics(LAW, CUTTER, conditions, 30)
    extra = (rng.standard_normal((3, 31)) + 1j * rng.standard_normal((3, 31))) * 3
    extra[:, [4, 6]] *= 2.5 * (number + 1)
    extra[2] *= 0.3
    harmonics = harmonics + extra * (np.arange(31) > 0)
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    average = force_at(harmonics, angle)
    noise = np.array([4.0, 4.5, 3.5]) * (1 + number)
    time = np.linspace(0, 1.4, 900)
    inside = (time > 0.2) & (time < 1.2)
    swing = np.abs(rng.standard_normal((3, 900))) * 3
    low = np.where(inside, average.min(axis=1, keepdims=True), 0.0) - swing
    high = np.where(inside, average.max(axis=1, keepdims=True), 0.0) + swing
    ac = np.sqrt(np.sum(np.abs(harmonics[:, 1:]) ** 2, axis=1) / 2)
    notices = (Notice("asynchronous", "Fy: lines at 975 Hz are no harmonics; listen for chatter", f"f{number}"),)
    return CutForce(
        name=f"cuts/f{300 * (number + 1)}.txt",
        cutter=CUTTER,
        conditions=conditions,
        harmonics=harmonics,
        harmonics_variance=np.full((3, 31), 0.1),
        mean_all_rows=np.real(harmonics[:, 0]),
        revolution_means=np.real(harmonics[:, :1]) + rng.standard_normal((3, 100)),
        average_angle=angle,
        average=average,
        scatter=np.broadcast_to(noise[:, np.newaxis], (3, 360)),
        ac_rms=np.hypot(ac, noise),
        asynchronous_rms=noise,
        overview_time=time,
        overview_low=low,
        overview_high=high,
        removed_offset=np.array([1.2, -0.4, 3.1]),
        removed_drift=np.array([0.5, 0.1, -0.02]),
        sample_rate=10000.0,
        spindle_frequency=99.996 + 0.001 * number,
        spindle_frequency_sd=2e-4,
        revolutions=99,
        steady=(0.2, 1.2),
        air=((0.0, 0.15), (1.25, 1.4)),
        lowpass=2500.0 if number == 0 else None,
        peaks=(AsynchronousPeak("y", 975.0, 9.4, 6.0),) if number == 4 else (),
        notices=notices if number == 4 else (),
    )


@pytest.fixture(scope="session")
def cuts() -> tuple[CutForce, ...]:
    rng = np.random.default_rng(1)
    return tuple(cut_force(number, rng) for number in range(5))


@pytest.fixture(scope="session")
def coefficients(cuts) -> Coefficients:
    angle = cuts[0].average_angle
    predicted = np.stack([force_harmonics(LAW, CUTTER, cut.conditions, 30) for cut in cuts])
    measured = np.stack([cut.harmonics for cut in cuts])
    names = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae", "c0")
    mean = np.array([*LAW.cutting, *LAW.edge, 11.2e-6])
    half = np.array([197e6, 302e6, 222e6, 16.4e3, 23.8e3, 18.3e3, 1.4e-6])
    posterior = Posterior(
        names=names,
        units=("N/m^2",) * 3 + ("N/m",) * 3 + ("m",),
        mean=mean,
        covariance=np.diag((half / 2.8) ** 2),
        interval=np.stack([mean - half, mean + half], axis=1),
        law="linear-edge",
        method="nls",
    )
    keys = names[:6]
    return Coefficients(
        posterior=posterior,
        cutter=CUTTER,
        conditions=tuple(cut.conditions for cut in cuts),
        cuts=tuple(cut.name for cut in cuts),
        verdict="does not fit: 2 c0 exceeds the smallest feed per tooth by half; harmonics 4 and 6 are 3 to 9 times the model's",
        checks=(
            Check("asynchronous power", True, "at most 1.9 % of the power does not follow the spindle"),
            Check("contact loss", False, "2 c0 = 22 µm is more than half of the smallest feed per tooth, 25 µm"),
            Check(
                "harmonics above tooth passing", False, "k = 4 and 6 are 3 to 9 times the model's and grow with feed"
            ),
        ),
        feed_per_tooth=np.array(FEEDS),
        measured_mean=np.real(measured[:, :, 0]) + np.array([3.0, -1.0, 2.0]),
        modelled_mean=np.real(predicted[:, :, 0]),
        angle=angle,
        measured=np.stack([cut.average for cut in cuts]),
        modelled=np.stack([force_at(h, angle) for h in predicted]),
        measured_amplitude=np.abs(measured),
        modelled_amplitude=np.abs(predicted),
        residual_rms=np.array([31.2, 44.1, 12.0]),
        r2=np.array([0.865, 0.9967, 0.787]),
        in_sample=np.array([0.15, 0.17, 0.70]),
        left_out=np.array([0.17, 0.19, 0.77]),
        left_out_by_cut=np.array(
            [[0.3, 0.32, 0.6], [0.12, 0.13, 0.7], [0.1, 0.12, 0.8], [0.15, 0.16, 0.8], [0.2, 0.2, 0.9]]
        ),
        in_sample_wide=np.array([0.49, 0.64, 0.85]),
        left_out_wide=np.array([0.49, 0.65, 0.85]),
        phase=np.array([0.1, 1.2, 2.3, -0.4, 3.0]),
        band=(0, 2),
        alternatives=(
            ("average", tuple(zip(keys, (958.9e6, 250.9e6, 146.4e6, 15.76e3, 19.43e3, 18.21e3), strict=True))),
            ("average with contact loss", tuple(zip(keys, (898e6, 165e6, 26e6, 20.9e3, 26.6e3, 28.1e3), strict=True))),
        ),
        notices=(Notice("no-repeat", "no cut was repeated; the intervals cannot tell scatter from misfit"),),
    )


def mode(frequency: np.ndarray, natural: float, damping: float, stiffness: float) -> np.ndarray:
    ratio = frequency / natural
    return 1 / (stiffness * (1 - ratio**2 + 2j * damping * ratio))


@pytest.fixture(scope="session")
def frf() -> Frf:
    rng = np.random.default_rng(2)
    f = np.arange(2, 2000) * 1.0
    truth = np.zeros((len(f), 2, 2), complex)
    truth[:, 0, 0] = mode(f, 620, 0.03, 1.9e7) + mode(f, 1180, 0.02, 5.5e7)
    truth[:, 1, 1] = mode(f, 710, 0.035, 2.3e7) + mode(f, 1290, 0.018, 4.1e7)
    truth[:, 0, 1] = truth[:, 1, 0] = 0.05 * truth[:, 0, 0]
    acceleration = -((2 * np.pi * f) ** 2)[:, np.newaxis, np.newaxis] * truth
    sd = 0.02 * np.abs(acceleration) + 0.02 * (1 + (f / 900) ** 4)[:, np.newaxis, np.newaxis]
    noise = rng.standard_normal(truth.shape) + 1j * rng.standard_normal(truth.shape)
    coherence = np.clip(np.abs(acceleration) ** 2 / (np.abs(acceleration) ** 2 + 4 * sd**2), 0, 1)
    hits = tuple(
        Hit("impact.h5", i, 0.4 + 1.1 * i, 310.0 + 13 * i, i != 3, ("double",) if i == 3 else ()) for i in range(12)
    )
    return Frf(
        frequency=f,
        values=acceleration + sd * noise / np.sqrt(2),
        coherence=coherence,
        multiple_coherence=coherence[:, :, 0],
        variance=sd**2,
        force_spectrum=np.stack([2.0 / (1 + (f / 1400) ** 4), 1.8 / (1 + (f / 1500) ** 4)], axis=1),
        form="accelerance",
        estimator="h1",
        outputs=("tipX", "tipY"),
        inputs=("tipX", "tipY"),
        hits_used=(6, 5),
        usable_band=(60.0, 1600.0),
        hits=hits,
        notices=(
            Notice("low-coherence", "coherence below 0.9 between 1700 and 2000 Hz; hit harder or with a harder tip"),
        ),
    )


@pytest.fixture(scope="session")
def stability() -> StabilityMap:
    """One mode, speed-direct: every chatter frequency above the natural one belongs to one speed of each lobe."""
    rpm = np.linspace(2000, 14000, 1500)
    chatter = np.linspace(621, 1400, 20000)
    real = np.real(mode(chatter, 620, 0.03, 1.9e7))
    imaginary = np.imag(mode(chatter, 620, 0.03, 1.9e7))
    depth = -np.pi / (2 * 2 * 893e6 * real) * 0.9
    epsilon = np.pi + 2 * np.arctan2(imaginary, real)
    best = np.full(len(rpm), np.inf)
    lobe, frequency = np.full(len(rpm), -1.0), np.full(len(rpm), np.nan)
    for k in range(12):
        speed = 60 * chatter / (2 * (k + (epsilon % (2 * np.pi)) / (2 * np.pi)))
        order = np.argsort(speed)
        limit = np.interp(rpm, speed[order], depth[order], left=np.inf, right=np.inf)
        lower = limit < best
        frequency[lower] = np.interp(rpm, speed[order], chatter[order])[lower]
        lobe[lower], best[lower] = k, limit[lower]
    speeds = tuple(
        BestSpeed(n * 2 * np.pi / 60, a * 1e-3, n * 2 * a * 1e-3 * 25e-3 * 1e-4 / 60, p, 0.8e-3 * a)
        for n, a, p in ((9400, 8.9, 0.43), (6310, 6.6, 0.47), (4720, 5.2, None))
    )
    limits = np.isfinite(best)
    return StabilityMap(
        spindle_speed=rpm * 2 * np.pi / 60,
        limit_depth=best,
        chatter_frequency=frequency,
        limit_kind=np.where(limits, 0, -1),
        lobe=lobe,
        crossing_speed=rpm[limits] * 2 * np.pi / 60,
        crossing_depth=best[limits],
        crossing_kind=np.zeros(np.count_nonzero(limits)),
        crossing_frequency=frequency[limits],
        crossing_loses=np.ones(np.count_nonzero(limits)),
        limit_low=best * 0.8,
        limit_high=best * 1.25,
        method="zoa",
        teeth=2,
        radial_depth=25e-3,
        diameter=25e-3,
        direction="slot",
        feed_per_tooth=0.1e-3,
        absolute_minimum=float(best.min()),
        absolute_minimum_frequency=640.0,
        best=speeds,
        operating=OperatingPoint(SPEED, 1.2e-3, 1.19e-3, False, "hopf", 690.0, (0.92e-3, 1.51e-3), 0.42),
        notices=(Notice("zero-order", "at a radial depth below a tenth of the diameter use another method"),),
    )


@pytest.fixture(scope="session")
def summary() -> dict:
    return {
        "title": 'Slot series in aluminium <AlMg3> & "friends"',
        "warnings": [{"code": "data", "message": "the rows are fewer than the header says", "where": "f300.txt"}],
        "expect": [
            {"key": "coefficients.Ktc_N_per_mm2", "value": 893.2, "interval": [690, 720], "ok": False},
            {"key": "verdict", "value": "does not fit", "interval": "does not fit", "ok": True},
            {"key": "stability.best.0.rpm", "value": 12400, "interval": [12000, 13000], "ok": True},
        ],
        "recordings": [
            {
                "name": "cuts/f300.txt",
                "path": "/data/cuts/f300.txt",
                "kind": "cut",
                "sample_rate_hz": 10000.0,
                "duration_s": 1.4,
                "channels": [{"name": "fx", "quantity": "force", "unit": "N", "dof": "tipX"}],
            }
        ],
    }


@pytest.fixture(scope="session")
def provenance() -> dict:
    return {
        "millcal": "0.1.0",
        "python": "3.11.2",
        "numpy": "2.1.0",
        "scipy": "1.14.0",
        "h5py": "3.11.0",
        "seed": 7,
        "inputs": {"/data/cuts/f300.txt": "ab" * 32, "/data/impact.h5": "0f" * 32},
        "recipe": 'title = "Slot <series>"\n[cutter]\ndiameter_mm = 25\n',
    }


@pytest.fixture(scope="session")
def results(cuts, frf, coefficients, stability) -> dict:
    return {"cuts": cuts, "frf": frf, "coefficients": coefficients, "stability": stability}
