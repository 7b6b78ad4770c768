"""Stability maps made by hand: lobes of one mode and, as in cuts of low immersion, islands of period doubling between them."""

from dataclasses import replace

import numpy as np

from millcal.data import BestSpeed, CutTests, Notice, OperatingPoint, SimulatedCuts, StabilityMap

RPM = 2 * np.pi / 60  # rad/s
NATURAL, TEETH = 920.0, 2  # Hz
SMALLEST = 1.1e-3  # m
ISLANDS = (  # middle in rpm and mm, half width in rpm and mm
    (9340.0, 6.2, 110.0, 3.1),  # alone in a stable pocket
    (6900.0, 3.2, 190.0, 1.3),  # grown together with a lobe
    (12200.0, 2.6, 240.0, 0.9),  # within a lobe
)


def hopf_depth(rpm: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Limit in m, chatter frequency in Hz and lobe of cusps as one mode has them.   rpm : (speed,)"""
    waves = 60 * NATURAL / (TEETH * rpm)
    lobe = np.floor(waves)
    below = waves - lobe  # 0 at the tooth passing's multiples, where most is stable
    depth = SMALLEST * (1 + 0.35 * np.tan(np.pi * (below - 0.45)) ** 2)
    return np.minimum(depth, 60e-3), NATURAL * (1 + 0.05 * (1 - below)), lobe


def crossings(rpm: np.ndarray, islands=ISLANDS) -> np.ndarray:
    """Every crossing: speed rad/s, depth m, kind, frequency Hz, loses.   returns (crossing, 5)"""
    limit, frequency, _ = hopf_depth(rpm)
    rows = [(n * RPM, b, 0, f, 1) for n, b, f in zip(rpm, limit, frequency, strict=True)]
    for n0, b0, wide, high in islands:
        for n in rpm[np.abs(rpm - n0) < wide]:
            half = high * np.sqrt(1 - ((n - n0) / wide) ** 2)
            chatter = n * TEETH / 60 * (np.floor(60 * NATURAL / (TEETH * n)) + 0.5)
            rows += [(n * RPM, (b0 - half) * 1e-3, 1, chatter, 1), (n * RPM, (b0 + half) * 1e-3, 1, chatter, 0)]
    found = np.array(rows)
    return found[np.lexsort([found[:, 1], found[:, 0]])]


def with_islands(points: int = 500, islands=ISLANDS, method: str = "floquet") -> StabilityMap:
    """Lobes and islands, what is asked of them, and nothing uncertain."""
    rpm = np.linspace(4000, 14000, points)
    found = crossings(rpm, islands)
    limit, frequency, lobe = hopf_depth(rpm)
    kind = np.zeros(points)
    for speed, depth, which, chatter, loses in found:
        i = int(np.argmin(np.abs(rpm * RPM - speed)))
        if loses and depth < limit[i]:
            limit[i], kind[i], frequency[i] = depth, which, chatter
    return StabilityMap(
        spindle_speed=rpm * RPM,
        limit_depth=limit,
        chatter_frequency=frequency,
        limit_kind=kind,
        lobe=lobe,
        crossing_speed=found[:, 0],
        crossing_depth=found[:, 1],
        crossing_kind=found[:, 2],
        crossing_frequency=found[:, 3],
        crossing_loses=found[:, 4],
        method=method,
        deepest=12e-3,
        teeth=TEETH,
        radial_depth=1e-3,
        diameter=10e-3,
        direction="down",
        feed_per_tooth=0.1e-3,
        absolute_minimum=float(limit.min()),
        absolute_minimum_frequency=float(frequency[np.argmin(limit)]),
        best=(
            BestSpeed(13930 * RPM, 8e-3, 1.2e-6, None, None, 3.1, 1840.0),
            BestSpeed(5520 * RPM, 12e-3, 0.7e-6, None, None, 1.1, 990.0),
        ),
        operating=OperatingPoint(
            spindle_speed=8900 * RPM,
            axial_depth=2.5e-3,
            limit=3.5e-3,
            stable=True,
            kind="flip",
            chatter_frequency=742.0,
            speed_margin=(700 * RPM, 1900 * RPM),
            advice=("raise the speed by 150 rpm: the limit is then 4.1 mm", "cut no deeper than 3.1 mm"),
        ),
        notices=(Notice("deepest", "looked to 12 mm"),),
    )


def limit_alone() -> StabilityMap:
    """The zero-order limit of the same cut: it knows no islands."""
    return replace(with_islands(islands=(), method="zoa"), operating=None, best=())


def tried() -> StabilityMap:
    """With cuts that were made, cuts that were simulated and a line of them sampled once per tooth."""
    rng = np.random.default_rng(5)
    map_ = with_islands()
    n, b = 4200 + 9600 * rng.random(14), 0.5 + 6 * rng.random(14)
    tests = CutTests(
        spindle_speed=n * RPM, axial_depth=b * 1e-3, stable=(b < 2).astype(float), name="cuts-in-february.csv"
    )
    speed, depth = (v.ravel() for v in np.meshgrid(np.linspace(4200, 13800, 16), np.linspace(0.5, 9, 9)))
    limit = hopf_depth(speed)[0] * 1e3
    period = np.where(depth > limit, 0, 1)
    for n0, b0, wide, high in ISLANDS:
        period[((speed - n0) / wide) ** 2 + ((depth - b0) / high) ** 2 < 1] = 2
    period[5] = 3
    line = np.repeat(np.linspace(8000, 10500, 120), 30)
    spread = np.where(np.abs(line - 9300) < 300, 40e-6 * np.sqrt(np.maximum(1 - ((line - 9300) / 300) ** 2, 0)), 0)
    sign = np.where(np.arange(len(line)) % 2, 1, -1)
    moved = (
        20e-6 + 1e-9 * (line - 8000) + sign * spread + np.where(line < 8200, 30e-6, 0) * rng.standard_normal(len(line))
    )
    simulated = SimulatedCuts(
        spindle_speed=speed * RPM,
        axial_depth=depth * 1e-3,
        period=period.astype(float),
        metric=np.where(period == 1, 1e-9, 2e-5),
        bifurcation_speed=line * RPM,
        bifurcation_depth=np.full(len(line), 5e-3),
        bifurcation_displacement=moved,
    )
    return replace(map_, tests=tests, simulated=simulated)


def probable(columns: int = 200) -> StabilityMap:
    """With the probability of a stable cut, as uncertain coefficients and modes give it."""
    map_ = with_islands(columns)
    rpm, depth = map_.spindle_speed / RPM, np.linspace(0.05, 12, 100)
    limit = hopf_depth(rpm)[0] * 1e3
    chance = 1 / (1 + (depth[:, np.newaxis] / limit) ** 14)
    for n0, b0, wide, high in ISLANDS:
        inside = np.hypot((rpm - n0) / wide, (depth[:, np.newaxis] - b0) / high)
        chance *= 1 / (1 + inside**-12.0)
    point = replace(map_.operating, p_stable=0.9, limit_interval=(2.3e-3, 4.4e-3))
    best = tuple(replace(b, safe_depth=0.75 * b.axial_depth, p_stable=0.5) for b in map_.best)
    return replace(map_, probability=chance, probability_depth=depth * 1e-3, operating=point, best=best)


def compared() -> tuple[StabilityMap, ...]:
    """The same cut by four methods."""
    exact = with_islands()
    off = 1 + 0.02 * np.sin(exact.spindle_speed / 40)
    measured = replace(
        exact, method="frf", limit_depth=exact.limit_depth * off, crossing_depth=exact.crossing_depth * 1.01
    )
    few = tried()
    chosen = slice(None, None, 25)
    followed = replace(
        few,
        method="time-domain",
        best=(),
        operating=None,
        **{
            name: getattr(few, name)[chosen]
            for name in ("spindle_speed", "limit_depth", "chatter_frequency", "limit_kind", "lobe")
        },
    )
    return limit_alone(), exact, measured, followed


MAKERS = {"islands": with_islands, "limit alone": limit_alone, "tried": tried, "probable": probable}
