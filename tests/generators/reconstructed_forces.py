"""Forces from accelerations made by hand, as the stage gives them: a slot, two cuts with a dynamometer beside them, a slot of four
teeth that tells only edge coefficients, one that does not fit, and one of which hardly anything is known.
"""

from dataclasses import replace

import numpy as np

from millcal.data import Check, Coefficients, CutVibration, ForceHarmonics, Notice, Posterior, SpeedAdvice
from millcal.physics.cutter import Cutter, CuttingConditions
from millcal.physics.cutting_force import LinearEdge, force_at, force_basis, force_harmonics

LAW = LinearEdge(np.array([1000e6, 700e6, 250e6]), np.array([50e3, 30e3, 15e3]))
NAMES = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")
UNITS = ("N/m^2",) * 3 + ("N/m",) * 3
TRUTH = np.array([*LAW.cutting, *LAW.edge])
SLOT = Cutter(diameter=20e-3, teeth=2)
ANGLE = np.linspace(0, 2 * np.pi, 360, endpoint=False)
METHODS = ("ls", "tls", "tikhonov", "constrained-ls", "rtls", "gtls")
PRECISION = {"ls": 2.3, "tls": 2.8, "tikhonov": 1.9, "constrained-ls": 1.5, "rtls": 1.6, "gtls": 1.0}  # sd beside gtls
LAST = 60  # harmonic of the law's force


def rpm(value: float) -> float:
    return value * 2 * np.pi / 60


def slot(speed: float = rpm(2340.0), depth: float = 2e-3) -> CuttingConditions:
    return CuttingConditions(speed, 0.15e-3, depth, 20e-3, "slot")


def structure(sensors: int, axes: int, rng: np.random.Generator):
    """An accelerance of three damped modes.   returns f (line,) Hz -> (line, sensor, axis) (m/s^2)/N"""
    natural, damping, mass = np.array([60.0, 82.0, 103.0]), np.array([0.1, 0.15, 0.07]), np.array([200.0, 150.0, 130.0])
    shape = rng.uniform(0.3, 1.0, (sensors, 3)) * rng.choice([-1, 1], (sensors, 3))
    direction = np.linalg.qr(rng.standard_normal((3, 3)))[0][:, :axes]

    def accelerance(f: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * np.asarray(f, float)[:, np.newaxis]
        w = 2 * np.pi * natural
        modal = s**2 / (mass * (s**2 + 2 * damping * w * s + w**2))
        return np.einsum("lr,sr,ra->lsa", modal, shape, direction)

    return accelerance


def law_lines(cutter: Cutter, conditions: CuttingConditions, orders: np.ndarray, axes: int) -> np.ndarray:
    """Harmonics of the force per unit of each coefficient.   returns complex (line, axis, coefficient)"""
    last = int(orders.max())
    basis = force_basis(lambda h: np.stack([np.ones_like(h), h]), cutter, conditions, last)
    columns = np.concatenate([basis[:, :, 1], basis[:, :, 0]], axis=1)  # (axis, cutting then edge, k)
    return np.moveaxis(columns[:axes], 2, 0)[orders]


def real(values: np.ndarray) -> np.ndarray:
    """Re over Im along the first axis."""
    return np.concatenate([values.real, values.imag])


def reconstructed(
    *,
    cutter: Cutter = SLOT,
    conditions: tuple[CuttingConditions, ...] = (slot(),),
    cuts: tuple[str, ...] = ("cuts/slot.h5",),
    axes: tuple[str, ...] = ("x", "y", "z"),
    sensors: tuple[str, ...] = ("spindleX", "spindleY", "spindleZ", "headX", "headY", "headZ"),
    harmonics: int = 3,
    sigma: float = 0.02,  # m/s^2, E|noise|^2 of a harmonic of the accelerations, its root
    frf_error: float = 0.02,  # relative
    dynamometer: bool = False,
    with_advice: bool = True,
    seed: int = 2012,
    **more,
) -> ForceHarmonics:
    """What the stage finds in such cuts, by weighted least squares of simulated lines; `more` replaces fields of the record."""
    rng = np.random.default_rng(seed)
    accelerance = structure(len(sensors), len(axes), rng)
    cut, order, frequency, lines = [], [], [], []
    for number, c in enumerate(conditions):
        orders = cutter.teeth * np.arange(1, harmonics + 1)
        cut += [number] * harmonics
        order += orders.tolist()
        frequency += (orders * c.spindle_speed / (2 * np.pi)).tolist()
        lines.append(law_lines(cutter, c, orders, len(axes)))
    law, f = np.concatenate(lines), np.array(frequency)  # (line, axis, coefficient)
    size = np.sqrt(np.sum(np.abs(law) ** 2, axis=(0, 1)))
    shown = np.flatnonzero(size * TRUTH > 1e-9 * np.max(size * TRUTH))
    frf = accelerance(f)
    truth = law @ TRUTH
    deviation = np.sqrt(sigma**2 + (frf_error * np.abs(frf @ truth[..., np.newaxis])[..., 0]) ** 2)
    noise = (rng.standard_normal(deviation.shape) + 1j * rng.standard_normal(deviation.shape)) / np.sqrt(2)
    measured = (frf @ truth[..., np.newaxis])[..., 0] + deviation * noise
    forward = (frf @ law)[..., shown] / deviation[..., np.newaxis]
    scale = TRUTH[shown]
    matrix = real(forward.reshape(-1, len(shown)) * scale)
    data = real((measured / deviation).ravel())
    covariance = np.linalg.inv(matrix.T @ matrix) / 2 * np.outer(scale, scale)
    mean = np.linalg.lstsq(matrix, data, rcond=None)[0] * scale
    force = law[..., shown] @ mean
    modelled = (frf @ force[..., np.newaxis])[..., 0]
    parts = np.concatenate([law[..., shown].real, law[..., shown].imag], axis=1)  # (line, part, coefficient)
    force_covariance = parts @ covariance @ np.swapaxes(parts, 1, 2)
    sd = np.sqrt(np.diag(covariance))
    weighted = np.abs(measured - modelled) ** 2 / deviation**2
    dof = 2 * measured.size - len(shown)
    share = np.sum(np.abs(forward) ** 2 * scale**2, axis=(0, 2))
    alternating, alternating_sd = np.empty((2, len(conditions), len(axes), len(ANGLE)))
    whole = np.empty_like(alternating)
    adopted = np.where(np.isin(np.arange(6), shown), 0.0, np.nan)
    adopted[shown] = mean
    for number, c in enumerate(conditions):
        here = np.flatnonzero(np.array(cut) == number)
        turn = np.exp(1j * np.outer(ANGLE, np.array(order)[here]))
        alternating[number] = np.real(np.einsum("al,lx->xa", turn, force[here]))
        slope = np.real(np.einsum("al,lxc->xac", turn, law[here][..., shown]))
        alternating_sd[number] = np.sqrt(np.einsum("xac,cd,xad->xa", slope, covariance, slope))
        found = LinearEdge(np.nan_to_num(adopted[:3]), np.nan_to_num(adopted[3:]))
        whole[number] = force_at(force_harmonics(found, cutter, c, LAST)[: len(axes)], ANGLE)
        unknown = np.isnan(adopted).reshape(2, 3).any(axis=0)
        whole[number][[bool(unknown[:2].any())] * 2 + [bool(unknown[2])] * (len(axes) - 2)] = np.nan
    beside = None
    if dynamometer:
        beside = alternating + 1.5 * alternating_sd * np.sin(3 * ANGLE) + 2 * rng.standard_normal(alternating.shape)
    inverse = np.linalg.pinv(frf / deviation[..., np.newaxis])  # (line, axis, sensor)
    free = (inverse @ (measured / deviation)[..., np.newaxis])[..., 0]
    free_sd = np.sqrt(np.sum(np.abs(inverse) ** 2, axis=2))
    names = tuple(NAMES[i] for i in shown)
    compared_sd = np.array([sd * PRECISION[method] for method in METHODS])
    compared = mean + compared_sd * 0.7 * rng.standard_normal(compared_sd.shape)
    compared[-1] = mean
    compared_sd[1:3] = np.nan
    return replace_fields(
        ForceHarmonics(
            method="gtls",
            cutter=cutter,
            conditions=conditions,
            cuts=cuts,
            axes=axes,
            sensors=sensors,
            verdict="fits",
            checks=(
                Check("residuals", True, "chi2 per degree of freedom is 1.05; 0.7 to 1.4 is what noise gives"),
                Check("condition", True, "the FRF of every line has a condition number below 30"),
            ),
            cut=np.array(cut),
            order=np.array(order),
            frequency=f,
            force=force,
            force_covariance=force_covariance,
            free_force=free,
            free_sd=free_sd,
            noise=np.full(deviation.shape, sigma),
            condition=np.linalg.cond(frf / deviation[..., np.newaxis]),
            condition_number=float(np.linalg.cond(matrix)),
            band=(float(f.min()), float(f.max())),
            measured=measured,
            modelled=modelled,
            deviation=deviation,
            sensor_residual=weighted.mean(axis=0),
            sensor_share=share / share.sum(),
            chi2=float(2 * weighted.sum() / max(dof, 1)),
            dof=dof,
            angle=ANGLE,
            alternating=alternating,
            alternating_sd=alternating_sd,
            law_force=whole,
            dynamometer=beside,
            posterior=Posterior(
                names=names,
                units=tuple(UNITS[i] for i in shown),
                mean=mean,
                covariance=covariance,
                interval=np.stack([mean - 1.96 * sd, mean + 1.96 * sd], axis=1),
                law="linear-edge",
                method="gtls",
                dof=float(dof),
            ),
            unobservable=tuple((name,) for i, name in enumerate(NAMES) if i not in shown),
            rank=len(shown),
            constraint_rows=2 * harmonics * len(axes) - len(shown),
            complex_rows=2 if len(axes) == 3 else 1,
            phase=np.full(len(conditions), np.radians(41.3)),
            phase_sd=np.full(len(conditions), np.radians(0.47)),
            phase_from="fitted",
            frf_from="measured",
            compared_methods=METHODS,
            compared=compared,
            compared_sd=compared_sd,
            recommended="gtls",
            recommended_why="it weighs every line and sensor by its noise, and the law's equations hold within it",
            advice=advice(names) if with_advice else None,
        ),
        more,
    )


def replace_fields(record, fields: dict):
    return replace(record, **fields) if fields else record


def advice(names: tuple[str, ...], low: float = 900.0, high: float = 4500.0) -> SpeedAdvice:
    """Expected deviations that rise at two bad speeds and beyond the modes."""
    speed = np.linspace(low, high, 200)
    bump = 1 + 5 * np.exp(-(((speed - 1590) / 90) ** 2)) + 3 * np.exp(-(((speed - 3350) / 160) ** 2))
    rise = 0.6 + (speed / 2400 - 1) ** 2
    size = {"Ktc": 0.02, "Krc": 0.032, "Kac": 0.05, "Kte": 0.06, "Kre": 0.09, "Kae": 0.12}
    relative = np.stack([size[name] * bump ** (1 if name != "Krc" else 0.8) * rise for name in names], axis=1)
    return SpeedAdvice(
        spindle_speed=rpm(speed),
        names=names,
        relative_sd=relative,
        condition=4 * bump,
        best=(rpm(2400.0), rpm(1950.0), rpm(2800.0)),
        worst_harmonic=np.where(speed < 2000, 3.0, 1.0),
        harmonics=3,
    )


def two_cuts() -> ForceHarmonics:
    """Half immersion with helix at two speeds, in the plane, beside a dynamometer; its angle was stated."""
    cutter = Cutter(diameter=20e-3, teeth=2, helix=np.pi / 6)
    conditions = tuple(CuttingConditions(rpm(n), 0.15e-3, 2e-3, 10e-3, "down") for n in (2310.0, 3060.0))
    made = reconstructed(
        cutter=cutter,
        conditions=conditions,
        cuts=("cuts/n2310.h5", "cuts/n3060.h5"),
        axes=("x", "y"),
        sensors=("headX", "headY", "quillX", "quillY"),
        harmonics=4,
        dynamometer=True,
        seed=7,
        phase_from="stated",
        phase_sd=np.zeros(2),
    )
    worse = made.measured * np.where(np.arange(4) == 2, 1.22, 1.0)  # a sensor with a wrong sensitivity
    residual = np.abs(worse - made.modelled) ** 2 / made.deviation**2
    return replace(
        made,
        measured=worse,
        sensor_residual=residual.mean(axis=0),
        verdict="does not fit: quillX is 22 % off at every harmonic; check its sensitivity",
        checks=(Check("sensors", False, "quillX: residual 9 times the expected one; check its sensitivity"),),
        chi2=float(residual.mean()),
        notices=(Notice("sensor-residual", "quillX: residuals 9 times the expected ones; check its sensitivity"),),
    )


def four_teeth() -> ForceHarmonics:
    """A slot of four teeth: its harmonics tell edge coefficients alone; no advice, no fitted angle."""
    return reconstructed(
        cutter=Cutter(diameter=20e-3, teeth=4),
        conditions=(slot(rpm(1200.0)),),
        axes=("x", "y"),
        harmonics=2,
        with_advice=False,
        seed=3,
        unobservable=(("Ktc",), ("Krc",), ("Kac",), ("Kae",)),
        verdict="fits in part: Ktc, Krc are not told by these cuts",
    )


def bare() -> ForceHarmonics:
    """As many sensors as axes and least squares: no deviations, no comparison, one line."""
    made = reconstructed(
        axes=("x", "y"), sensors=("tipX", "tipY"), harmonics=1, with_advice=False, seed=5, cuts=("slot.csv",)
    )
    none = np.full(made.force_covariance.shape, np.nan)
    unknown = np.full(len(made.posterior.names), np.nan)
    posterior = replace(
        made.posterior,
        method="ls",
        covariance=np.full((len(unknown),) * 2, np.nan),
        interval=np.stack([unknown, unknown], axis=1),
    )
    return replace(
        made,
        method="ls",
        posterior=posterior,
        force_covariance=none,
        free_force=None,
        free_sd=None,
        noise=None,
        deviation=np.full(made.deviation.shape, np.nan),
        sensor_residual=np.full(2, np.nan),
        sensor_share=np.full(2, np.nan),
        chi2=np.nan,
        dof=0,
        alternating_sd=np.full(made.alternating.shape, np.nan),
        law_force=None,
        compared_methods=(),
        compared=np.empty((0, len(unknown))),
        compared_sd=np.empty((0, len(unknown))),
        recommended="",
        recommended_why="",
        checks=(),
        notices=(Notice("no-redundancy", "2 sensors for 2 axes: nothing tests the force", "slot.csv"),),
    )


def many_cuts() -> ForceHarmonics:
    """Nine cuts of many harmonics, and methods that fail badly."""
    speeds = np.linspace(1200.0, 3600.0, 9)
    made = reconstructed(
        conditions=tuple(slot(rpm(n)) for n in speeds),
        cuts=tuple(f"cuts/n{n:.0f}.h5" for n in speeds),
        harmonics=9,
        regularization=2.3e-4,
        regularization_from="gcv",
        seed=9,
    )
    compared = made.compared.copy()
    compared[1] *= np.array([-3.0, 14.0, 1.2, 0.4, 20.0])[: compared.shape[1]]
    return replace(made, compared=compared)


MAKERS = {
    "a slot": reconstructed,
    "two cuts, a bad sensor": two_cuts,
    "four teeth": four_teeth,
    "hardly anything": bare,
    "many cuts": many_cuts,
}


def vibrations(forces: ForceHarmonics, seed: int = 1) -> tuple[CutVibration, ...]:
    """The conditioned cuts behind the forces."""
    rng = np.random.default_rng(seed)
    made = []
    n = len(forces.sensors)
    last = int(forces.order.max())
    for number, (name, conditions) in enumerate(zip(forces.cuts, forces.conditions, strict=True)):
        here = forces.cut == number
        harmonics = np.zeros((n, last + 1), complex)
        harmonics[:, forces.order[here].astype(int)] = forces.measured[here].T
        ac = np.sqrt(np.sum(np.abs(harmonics) ** 2, axis=1) / 2)
        noise = 0.15 * ac * (1 + np.arange(n) / 3)
        time = np.linspace(0, 3.0, 700)
        swing = np.where((time > 0.6) & (time < 2.5), 2.2, 0.1) * ac[:, np.newaxis]
        jitter = np.abs(rng.standard_normal((n, 700))) * noise[:, np.newaxis]
        rate = conditions.spindle_speed / (2 * np.pi)
        made.append(
            CutVibration(
                name=name,
                cutter=forces.cutter,
                conditions=conditions,
                sensors=forces.sensors,
                harmonics=harmonics,
                covariance=np.broadcast_to(np.diag(noise**2 / 60).astype(complex), (last + 1, n, n)),
                lines_between=np.full(last + 1, 12.0),
                angle_from="pulse",
                ac_rms=np.hypot(ac, noise),
                asynchronous_rms=noise,
                overview_time=time,
                overview_low=-swing - jitter,
                overview_high=swing + jitter,
                sample_rate=5120.0,
                spindle_frequency=rate,
                spindle_frequency_sd=1e-4,
                revolutions=int(1.7 * rate),
                steady=(0.7, 2.4),
            )
        )
    return tuple(made)


def coefficients_of(forces: ForceHarmonics) -> Coefficients:
    """As the stage makes them of such forces: no mean force, nan for an axis that no line has."""
    cuts, axes, points = forces.alternating.shape
    measured, modelled = np.full((2, cuts, 3, points), np.nan)
    measured[:, :axes] = forces.alternating
    if forces.law_force is not None:
        modelled[:, :axes] = forces.law_force
    last = int(forces.order.max())
    amplitude = np.full((cuts, 3, last + 1), np.nan)
    amplitude[forces.cut[:, np.newaxis], np.arange(axes), forces.order[:, np.newaxis]] = np.abs(forces.force)
    nothing = np.full((cuts, 3), np.nan)
    per_axis = np.array([*[0.99] * axes, *[np.nan] * (3 - axes)])
    return Coefficients(
        posterior=forces.posterior,
        cutter=forces.cutter,
        conditions=forces.conditions,
        cuts=forces.cuts,
        verdict=forces.verdict,
        checks=forces.checks,
        feed_per_tooth=np.array([c.feed_per_tooth for c in forces.conditions]),
        measured_mean=nothing,
        modelled_mean=modelled.mean(axis=2),
        angle=forces.angle,
        measured=measured,
        modelled=modelled,
        measured_amplitude=amplitude,
        modelled_amplitude=amplitude * 1.02,
        residual_rms=per_axis * 3,
        r2=per_axis,
        phase=forces.phase,
        band=(forces.cutter.teeth, last),
    )
