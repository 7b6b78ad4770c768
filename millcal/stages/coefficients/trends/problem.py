"""Recorded cuts as one problem: what was measured, how the tool met the work, and what the force chain made of it.

Cuts lie one behind the other. A cut of its own sensor phase has an angle of its own, which is a parameter; runout is shared by
all cuts. The chain of the force (a low-pass of the amplifier) is part of the model: it acts on the modelled force and on its
slopes alike, and the noise, coloured by the same chain, is whitened on both sides of the equation. Ignoring a low-pass of
300 Hz does not blur the answer, it destroys it.

Parameters are [kappa_t, s_t, kappa_r, s_r, (kappa_a, s_a,) c0, s0] as in `physics.sampled_force`, then the phase of each cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from millcal.data import AXES, CutSamples, Notice
from millcal.errors import IllPosedError
from millcal.numerics.whitening import Autoregression, fit_autoregression, whiten
from millcal.physics.cutter import Cutter
from millcal.physics.measuring_chain import discrete_butterworth
from millcal.physics.sampled_force import ChipRange, Passage, chip_quantiles, mean_chip, sampled_force

LAWS = ("kienzle", "linear-edge")
MOST_SAMPLES = 1_000_000  # of a longer record, stretches of whole revolutions evenly spread
STRETCH = 20  # revolutions of such a stretch
FORGET = 1e-3  # a low-pass has forgotten what happened when this share is left
SMOOTHING_ORDER = 4
SAMPLES_PER_CORNER = 2.5  # of a smoothed force that are used per period of the corner
FEWEST_IDLE = 200  # samples between teeth that can tell the noise
PHASE_STEP = 1e-3  # rad, for the slope of the force in the spindle angle
DIRECTIONS = ("t", "r", "a")
NAMES = {"kienzle": ("k{0}", "m{0}"), "linear-edge": ("K{0}c", "K{0}e")}  # of the coefficients of a direction


@dataclass(frozen=True, eq=False)
class CutRecord:
    """All cuts, sample by sample."""

    cuts: tuple[CutSamples, ...]
    cutter: Cutter
    axes: tuple[str, ...]
    law: str
    nodes: int
    passage: Passage  # with the spindle angle as recorded
    force: np.ndarray  # (sample, axis) N
    sign: np.ndarray  # (axis,) of what is fitted: an axial force that pulls is fitted turned round
    time: np.ndarray  # (sample,) s, running on over the cuts
    cut: np.ndarray  # (sample,) int
    edges: np.ndarray  # (piece + 1,) where contiguous samples end
    lowpass: tuple[np.ndarray, np.ndarray] | None  # (b, a)
    memory: int  # samples that the low-pass remembers
    every: int  # of the samples one in so many is used: a smoothed force has no more to say
    smoother: tuple[np.ndarray, np.ndarray] | None  # what the force itself went through here, part of `lowpass`
    chips: ChipRange
    notices: tuple[Notice, ...]

    @property
    def directions(self) -> int:
        return 3 if "z" in self.axes else 2

    @property
    def parameters(self) -> int:
        """Those of `sampled_force`, and a phase for each cut."""
        return 2 * self.directions + 2 + len(self.cuts)

    @property
    def reference_chip(self) -> float:
        """h0, m"""
        return self.chips.reference

    def turned(self, phase: np.ndarray) -> Passage:
        """The passage with each cut's spindle angle moved.   phase : (cut,) rad"""
        return self.passage._replace(angle=self.passage.angle + np.asarray(phase)[self.cut])

    def response(self, parameters: np.ndarray, *, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """The force as the chain shows it, and its slopes.

        parameters : (parameter,) or (sample, parameter), phases last; of a phase the first row counts
        slopes : False leaves them as they are before the chain
        returns (sample, axis) N, (sample, axis, parameter)
        """
        own = 2 * self.directions + 2
        p = np.asarray(parameters, float)
        phase = p[..., own:] if p.ndim == 1 else p[0, own:]
        force, columns = self._force(p[..., :own], phase)
        force, columns = force * self.sign, columns * self.sign[:, np.newaxis]
        return self.through_chain(force), self.through_chain(columns) if slopes else columns

    def phase_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Slope of the force in the phase of each cut.   parameters : (parameter,)   returns (sample, axis, cut)"""
        own = 2 * self.directions + 2
        p = np.asarray(parameters, float)
        ahead, behind = (self._force(p[:own], p[own:] + step)[0] for step in (PHASE_STEP, -PHASE_STEP))
        slope = self.through_chain((ahead - behind) / (2 * PHASE_STEP) * self.sign)
        return slope[:, :, np.newaxis] * (self.cut[:, np.newaxis, np.newaxis] == np.arange(len(self.cuts)))

    def _force(self, parameters: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return sampled_force(
            parameters,
            self.turned(phase),
            self.cutter,
            law=self.law,
            reference_chip=self.reference_chip,
            axes=self.axes,
            nodes=self.nodes,
        )

    def through_chain(self, values: np.ndarray) -> np.ndarray:
        """The low-pass over each contiguous piece, which begins at rest.   values : (sample, ...)"""
        if self.lowpass is None:
            return values
        from scipy.signal import lfilter

        return np.concatenate([lfilter(*self.lowpass, piece, axis=0) for piece in np.split(values, self.edges[1:-1])])

    def contact(self, phase: np.ndarray, runout: tuple[float, float]) -> np.ndarray:
        """Mean chip at each sample.   returns (sample,) m"""
        return mean_chip(self.turned(phase), self.cutter, runout, nodes=self.nodes)

    def settled(self, samples: int) -> np.ndarray:
        """Where a piece has gone on for so many samples, so that a filter has forgotten that it began at rest.   (sample,) bool"""
        return np.arange(len(self.force)) - np.repeat(self.edges[:-1], np.diff(self.edges)) >= samples

    def of(self, samples: np.ndarray) -> "CutRecord":
        """Some of the samples.   samples : (sample,) bool, in whole stretches"""
        at = np.flatnonzero(samples)
        inner = 1 + np.flatnonzero((np.diff(at) > 1) | np.isin(at[1:], self.edges))
        return replace(
            self,
            passage=Passage(*(field[at] for field in self.passage)),
            force=self.force[at],
            time=self.time[at],
            cut=self.cut[at],
            edges=np.concatenate([[0], inner, [len(at)]]),
        )


@dataclass(frozen=True, eq=False)
class Noise:
    """What the channels show of no force."""

    channels: tuple[Autoregression, ...]  # of each axis
    source: str  # air, idle, residual

    @property
    def sd(self) -> np.ndarray:
        """(axis,) N"""
        return np.array([channel.total_sd for channel in self.channels])

    @property
    def order(self) -> int:
        return max(len(channel.coefficients) for channel in self.channels)

    def scaled(self, factor: float) -> "Noise":
        """The same colour, so much stronger."""
        return replace(
            self,
            channels=tuple(c._replace(sd=c.sd * factor, total_sd=c.total_sd * factor) for c in self.channels),
        )


def short_name(cut: CutSamples) -> str:
    """The file without its folder."""
    return cut.name.replace("\\", "/").rsplit("/", 1)[-1]


def cut_record(
    cuts: Sequence[CutSamples],
    *,
    law: str,
    lowpass: float | None,
    lowpass_order: int,
    smoothing: float | None,
    nodes: int,
) -> CutRecord:
    """The cuts as one record.

    lowpass, lowpass_order : of the force chain, Hz   smoothing : corner of a low-pass that force and model go through, Hz

    Raises
    ------
    IllPosedError
        The cuts are of different cutters, or their sampling and low-pass do not go together.
    """
    if any(cut.cutter != cuts[0].cutter for cut in cuts):
        raise IllPosedError("cuts: they were made with different cutters; follow each cutter by itself")
    rate = cuts[0].sample_rate
    if any(abs(cut.sample_rate / rate - 1) > 1e-6 for cut in cuts):
        raise IllPosedError("cuts: their sample rates differ; follow them one by one")
    axes = tuple(axis for axis in AXES if all(axis in cut.axes for cut in cuts))
    for cut in cuts:
        dead = [axis for axis in axes if not np.ptp(cut.force[cut.axes.index(axis)]) > 0]
        if dead:
            raise IllPosedError(
                f"{cut.name}: the force along {' and '.join(dead)} never changes; mend the channel, or leave it out of the map"
            )
    filtered, memory = None, 0
    if lowpass is not None:
        if not 0 < lowpass < rate / 2:
            raise IllPosedError(
                f"coefficients.chain_lowpass_hz: {lowpass:g} Hz is not below half the sample rate of {rate:g} Hz; leave it out"
            )
        filtered = discrete_butterworth(lowpass, lowpass_order, rate)
    smoother, every = None, 1
    if smoothing is not None:
        if not 0 < smoothing < rate / 2:
            raise IllPosedError(
                f"conditioning.lowpass_hz: {smoothing:g} Hz is not below half the sample rate of {rate:g} Hz; leave it out"
            )
        from scipy.signal import butter

        smoother, every = (
            butter(SMOOTHING_ORDER, smoothing, fs=rate),
            max(1, int(rate / (SAMPLES_PER_CORNER * smoothing))),
        )
        filtered = (
            smoother if filtered is None else tuple(np.convolve(x, y) for x, y in zip(filtered, smoother, strict=True))
        )
    if filtered is not None:
        slowest = np.abs(np.roots(filtered[1])).max()
        memory = int(np.ceil(np.log(FORGET) / np.log(slowest)))
    length = np.array([cut.force.shape[1] for cut in cuts])
    ends = np.concatenate([[0], np.cumsum(length)])
    passage = Passage(
        *(
            np.concatenate([getattr(cut, name) for cut in cuts])
            for name in ("angle", "feed_per_tooth", "axial_depth", "entry", "leave", "feed_direction")
        )
    )
    notices: list[Notice] = []
    record = CutRecord(
        cuts=tuple(cuts),
        cutter=cuts[0].cutter,
        axes=axes,
        law=law,
        nodes=nodes,
        passage=passage,
        force=np.concatenate(
            [_smoothed(cut.force[[cut.axes.index(axis) for axis in axes]].T, smoother) for cut in cuts]
        ),
        sign=np.ones(len(axes)),
        time=np.arange(ends[-1]) / rate,
        cut=np.repeat(np.arange(len(cuts)), length),
        edges=ends,
        lowpass=filtered,
        memory=memory,
        every=every,
        smoother=smoother,
        chips=ChipRange(1e-3, 1e-3, 1e-3),
        notices=(),
    )
    if ends[-1] > MOST_SAMPLES:
        record = record.of(evenly_spread(record, MOST_SAMPLES))
        seconds = len(record.force) / rate
        message = f"of {ends[-1] / rate:.3g} s, {seconds:.3g} s in stretches of {STRETCH} revolutions are followed"
        notices.append(Notice("thinned", message, "cuts", "note"))
    try:
        chips = chip_quantiles(record.passage, record.cutter)
    except ValueError:
        raise IllPosedError("cuts: no tooth meets the work; check the engagement and the conditions") from None
    return replace(record, chips=chips, notices=tuple(notices))


def _smoothed(force: np.ndarray, smoother: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """force : (sample, axis)"""
    if smoother is None or not len(force):
        return force
    from scipy.signal import lfilter

    return lfilter(*smoother, force, axis=0)


def evenly_spread(record: CutRecord, most: int) -> np.ndarray:
    """Stretches of whole revolutions that add up to about so many samples.   returns (sample,) bool"""
    number = np.floor(record.passage.angle / (2 * np.pi * STRETCH)).astype(np.int64)
    every = int(np.ceil(len(record.force) / most))
    return number % every == 0


def used_samples(record: CutRecord, chip: np.ndarray, threshold: float, order: int) -> np.ndarray:
    """Where the force says something: chips above the threshold, and while the chain remembers them.

    chip : mean chip (sample,) m   order : of the whitening filter, which needs as many samples of past
    returns (sample,) bool
    """
    used = chip >= threshold
    if record.memory:
        reach = np.cumsum(used)
        behind = (
            np.concatenate([np.zeros(record.memory, int), reach[: -record.memory]]) if len(reach) > record.memory else 0
        )
        used = used | (reach - behind > 0)
    used &= record.settled(record.memory + order)
    used[np.arange(len(used)) % record.every != 0] = False
    return used


def noise_of(record: CutRecord, chip: np.ndarray) -> Noise | None:
    """The noise by the air cuts, else by the samples between teeth; None where there are neither."""
    pieces: list[list[np.ndarray]] = [[] for _ in record.axes]
    for cut in record.cuts:
        for start, stop in cut.air_spans or ((0, cut.air_force.shape[1]),):
            piece = _smoothed(cut.air_force[:, start:stop].T, record.smoother)[
                record.memory if record.every > 1 else 0 :
            ]
            for row, axis in enumerate(record.axes):
                pieces[row].append(piece[:: record.every, cut.axes.index(axis)])
    if sum(len(piece) for piece in pieces[0]) >= FEWEST_IDLE:
        kept = [[piece for piece in of_axis if len(piece) > 8] for of_axis in pieces]
        return Noise(tuple(fit_autoregression(of_axis, 4 if record.every == 1 else 0) for of_axis in kept), "air")
    idle = idle_pieces(record, chip)
    if sum(stop - start for start, stop in idle) < FEWEST_IDLE:
        return None
    return Noise(
        tuple(
            fit_autoregression(
                [record.force[start:stop, row] for start, stop in idle],
                4 if record.every == 1 and idle_is_long(idle) else 0,
            )
            for row in range(len(record.axes))
        ),
        "idle",
    )


def idle_pieces(record: CutRecord, chip: np.ndarray) -> list[tuple[int, int]]:
    """Runs of samples in which no tooth cuts and the chain has forgotten the last one."""
    idle = chip <= 0
    starts = np.flatnonzero(idle & np.concatenate([[True], ~idle[:-1]]))
    stops = np.flatnonzero(idle & np.concatenate([~idle[1:], [True]])) + 1
    margin = record.memory + 2  # a sample or two beside a tooth depends on the last digit of the angle
    return [(a + margin, b - 2) for a, b in zip(starts, stops, strict=True) if b - 2 - (a + margin) >= 8]


def idle_is_long(pieces: Sequence[tuple[int, int]]) -> bool:
    """Whether the runs carry an autoregression."""
    return float(np.mean([stop - start for start, stop in pieces])) >= 40


def whitened(record: CutRecord, noise: Noise, values: np.ndarray) -> np.ndarray:
    """Each axis in units of its noise, white.   values : (sample, axis, ...)"""
    if noise.order == 0:
        return values / np.array([c.sd for c in noise.channels]).reshape(1, -1, *[1] * (values.ndim - 2))
    white = np.empty_like(values)
    for start, stop in zip(record.edges[:-1], record.edges[1:], strict=True):
        for row, channel in enumerate(noise.channels):
            white[start:stop, row] = whiten(channel, values[start:stop, row])
    return white
