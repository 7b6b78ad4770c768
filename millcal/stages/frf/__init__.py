"""Impact tests to a frequency response matrix: hits found, judged, windowed and averaged.

Each hit gets a verdict with a reason, and a rejected one stays in the table, so that the operator can overrule it
(`keep`, `drop`). Inputs are the dofs of the force channels, outputs those of the response channels, both in channel order;
recordings with the same input add hits, others add inputs. Several force channels in one recording are inputs at the same
time, told apart by least squares over the hits.

The estimate stays in the form that was measured unless another is asked for: dividing an accelerance by -w^2 blows up what
little offset and drift is left at low frequency, and has no value at all at 0 Hz (nan).

Where force channels answer the hammer (`Channel.role`), they are a dynamometer under it and the FRF is its transmissibility,
force over force: 1 at rest, and the only form there is.

A recording may be larger than the memory. It is read through once for its hits, and then each hit twice: to judge it, and for
its spectra, which go into sums at once. Only what a modal fit asks for is kept of each hit, in single precision.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from millcal.data import Frf, Recording
from millcal.errors import IllPosedError, RecordingError
from millcal.numerics.frequency_response import ESTIMATORS
from millcal.physics.structure import DERIVATIVES
from millcal.stages.frf.assembly import assemble
from millcal.stages.frf.spectra import compare, sum_up
from millcal.stages.frf.taps import LONGEST, SHORTEST, Tap, open_taps, survey_tap
from millcal.stages.frf.verdicts import judge, named_hits

MOST_POINTS = 16 * LONGEST  # of a transform
LATEST = 0.01  # s that a channel may be late


def estimate_frf(
    recordings: Recording | Sequence[Recording],
    *,
    estimator: str = "h1",
    form: str | None = None,
    keep: Sequence[int | str] = (),
    drop: Sequence[int | str] = (),
    allow_double: bool = False,
    weak: float = 0.15,
    hold_off: float = 0.1,
    record_length: float | None = None,
    resolution: float | None = None,
    exponential: float | None = None,
    delays: Mapping[str, float] | None = None,
    flip: Sequence[str] = (),
    progress: Callable[[float, str], None] | None = None,
) -> Frf:
    """Frequency response of all outputs to all inputs from impact tests.

    estimator : "h1", "h2" or "hv"
    form : "accelerance", "mobility" or "receptance"; None keeps what the first response channel measures;
        "transmissibility" takes the dynamometer's forces where motion was recorded beside them
    keep, drop : hits to use or leave out whatever is found, from 0 in each recording; `"tap_y.h5:3"` among several
    allow_double : use double hits too, with both pulses inside the force window
    weak : hits below this share of the median peak are left out
    hold_off : s; in a continuous recording, pulses closer than this belong to one hit
    record_length : s of each hit; None takes what the decay of the response needs, or the segments
    resolution : Hz between the lines at most, by adding zeros; None takes the record, and at least twice the decay
    exponential : value at the end of the shortest record of an exponential window on force and response; None puts on none
    delays : channel or dof -> s that it comes late, in place of the recording's own; positive where a signal is behind
    flip : channels or dofs to turn; a dof is that of a response, or of the hammer where nothing answers there
    progress : called with (share done, label)
    """
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not recordings:
        raise RecordingError("frf: no recording given; name at least one impact test")
    if estimator not in ESTIMATORS:
        raise IllPosedError(f"estimator {estimator}: not known; use one of {', '.join(ESTIMATORS)}")
    if form not in (None, "transmissibility", *DERIVATIVES):
        raise IllPosedError(f"form {form}: not known; use one of {', '.join(DERIVATIVES)}, transmissibility")
    if exponential is not None and not 0 < exponential < 1:
        raise IllPosedError(f"exponential {exponential:g}: no window ends there; give its value at the end, as 0.05")
    report = progress or (lambda share, label: None)
    rate = recordings[0].sample_rate
    for recording in recordings:
        if abs(recording.sample_rate - rate) > 1e-6 * rate:
            raise RecordingError(
                f"{recording.name}: sampled at {recording.sample_rate:g} Hz, {recordings[0].name} at {rate:g} Hz; "
                "recordings of one FRF need one rate"
            )
    _check_times(rate, record_length, resolution, delays or {})
    taps = open_taps(recordings, form, delays or {}, flip)
    _check_one_kind(taps)
    sizes = np.array([recording.samples.shape[1] for recording in recordings], float)
    shares = np.concatenate([[0.0], np.cumsum(sizes) / sizes.sum()])
    for tap, low, high in zip(taps, shares[:-1], shares[1:], strict=True):
        label = f"hits of {tap.recording.name}"
        survey_tap(
            tap,
            hold_off,
            record_length,
            lambda share, low=low, high=high, label=label: report(0.7 * (low + share * (high - low)), label),
        )
    kept, dropped = named_hits(taps, keep, "keep"), named_hits(taps, drop, "drop")
    if kept & dropped:
        raise RecordingError("keep and drop: one hit is in both; name it in one of them")
    for tap in taps:
        judge(tap, weak, allow_double, kept, dropped)
    points = _points(taps, rate, resolution)
    damping = 0.0 if exponential is None else -float(np.log(exponential)) / min(tap.length for tap in taps)
    for tap, low, high in zip(taps, shares[:-1], shares[1:], strict=True):
        label = f"spectra of {tap.recording.name}"
        sum_up(
            tap,
            points,
            damping,
            lambda share, low=low, high=high, label=label: report(0.7 + 0.25 * (low + share * (high - low)), label),
        )
        compare(tap, points, damping, kept)
    report(0.95, "frequency response")
    return assemble(taps, points, rate, estimator, form, damping * rate)


def _check_times(
    rate: float, record_length: float | None, resolution: float | None, delays: Mapping[str, float]
) -> None:
    """Refuse lengths, spacings and delays that no impact test has."""
    if record_length is not None and not SHORTEST / rate <= record_length <= LONGEST / rate:
        raise IllPosedError(
            f"record_length {record_length:g} s: a hit has {SHORTEST} to {LONGEST} samples; give {SHORTEST / rate:.2g} to "
            f"{LONGEST / rate:.2g} s"
        )
    if resolution is not None and not rate / MOST_POINTS <= resolution <= rate / SHORTEST:
        raise IllPosedError(
            f"resolution {resolution:g} Hz: give {rate / MOST_POINTS:.2g} to {rate / SHORTEST:.4g} Hz at this sample rate"
        )
    for name, delay in delays.items():
        if not abs(delay) <= LATEST:
            raise IllPosedError(
                f"delay {name}={delay:g}: no channel is that late against another; give at most {LATEST:g} s"
            )


def _check_one_kind(taps: list[Tap]) -> None:
    """Motion in one recording and forces in another are two FRFs."""
    of_forces = [tap.recording.channels[tap.responses[0]].quantity == "force" for tap in taps]
    if len(set(of_forces)) > 1:
        forces, motion = (taps[of_forces.index(kind)].recording.name for kind in (True, False))
        raise RecordingError(
            f"{forces}: the responses are a dynamometer's forces, in {motion} they are motions; "
            "estimate the two FRFs one by one"
        )


def _points(taps: list[Tap], rate: float, resolution: float | None) -> int:
    """Points of the transform: a power of two that holds the records and twice the decay, or the resolution asked for.

    Twice the decay gives at least four lines in the half-power width of the slowest mode.
    """
    longest = max(tap.length for tap in taps)
    if resolution is not None:
        return max(longest, int(np.ceil(rate / resolution)))
    decays = [2.0 * float(tap.decay.max()) for tap in taps if tap.decay.max() < tap.length]
    return 1 << int(np.ceil(np.log2(max([longest, *decays]))))
