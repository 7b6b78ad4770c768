"""The sample rate from a column of times, which may be rounded, jittered, broken, or start anywhere.

The median step of a rounded column is wrong: 51.2 kHz written with 7 decimals has steps of 1.95e-5 s, which is
51282 Hz. (n - 1) / (last - first) errs only by the rounding of two times; within that error the number with the fewest
digits is taken, because samplers are set to such numbers, and the file's own header wins where it agrees.
"""

from collections.abc import Callable
from math import floor, log10

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError

TIME_UNITS = {
    "s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6,
    "ns": 1e-9, "min": 60.0, "h": 3600.0,
}  # fmt: skip
SLOWEST, FASTEST = 10.0, 50e6  # Hz; outside, a unit is wrong
MATTERS = 1e-5  # relative; what a spindle speed is known to
_COARSE = 256  # every so many times one is kept for the final look at the line
_DIGITS = 10.0 ** np.arange(13)
_DAY = 86400.0


def time_unit(text: str | None) -> float | None:
    """Seconds in a unit of time as written in a file, or None."""
    return None if text is None else TIME_UNITS.get(text.strip().strip("[]()").strip().lower())


class TimeBase:
    """Takes the times block by block, keeps a few numbers, and tells the rate in the end.

    A class because the times of a long file pass by once: `add` each block, then `rate`.
    """

    def __init__(self, path: object, name: str, place: Callable[[int], str]) -> None:
        self.where = f"{path}: column '{name}'"
        self.place = place
        self.n = 0
        self.first = self.last = 0.0
        self.shortest, self.longest, self.longest_at = np.inf, -np.inf, 0
        self.backwards_at = self.repeated = 0
        self.resolution = 0.0
        self.magnitude = 0.0
        self.coarse: list[np.ndarray] = []

    def add(self, times: np.ndarray) -> None:
        """Times of the next samples.   times : (n,) s"""
        if not len(times):
            return
        if not np.isfinite(times).all():
            row = self.n + int(np.argmin(np.isfinite(times)))
            raise RecordingError(
                f"{self.where}: no time at {self.place(row)}; mend the cell, or leave the column out "
                "and state the rate with --rate-hz"
            )
        self.first = float(times[0]) if self.n == 0 else self.first
        steps = np.diff(times, prepend=self.last) if self.n else np.diff(times)
        if len(steps):
            at_least, at_most = int(np.argmin(steps)), int(np.argmax(steps))
            first_step = self.n if self.n else 1  # row at which the first of these steps ends
            if steps[at_least] < 0 and not self.backwards_at:
                self.backwards_at = first_step + int(np.argmax(steps < 0))
            if steps[at_most] > self.longest:
                self.longest, self.longest_at = float(steps[at_most]), first_step + at_most
            self.shortest = min(self.shortest, float(steps[at_least]))
            if steps[at_least] <= 0:
                self.repeated += int(np.count_nonzero(steps == 0))
        self.coarse.append(times[(-self.n) % _COARSE :: _COARSE].copy())
        # Numbers of so many digits lose decimals as they grow: 0.0000195 s, but 0.9999805 s.
        self.resolution = max(self.resolution, _resolution(times[:256]), _resolution(times[-256:]))
        self.magnitude = max(self.magnitude, abs(self.first), abs(float(times[-1])))
        self.n, self.last = self.n + len(times), float(times[-1])

    def rate(self, stated: float | None, header: float | None) -> tuple[float, list[Notice]]:
        """The sample rate in Hz, and what should be said about it.

        stated : by the user, Hz; wins   header : by the file, Hz; wins where the times agree with it
        """
        if stated is not None:
            return stated, self._compare_stated(stated)
        if self.n < 2 or self.longest == self.shortest == 0:
            raise RecordingError(f"{self.where}: the time does not advance; state the rate with --rate-hz")
        if self.backwards_at:
            raise RecordingError(
                f"{self.where}: the time goes backwards at {self.place(self.backwards_at)}; "
                "cut the file there, or state the rate with --rate-hz"
            )
        span = self.last - self.first
        measured = (self.n - 1) / span
        step = 1 / measured
        # Equal steps show no rounding, however few their digits are.
        rounding = min(self.resolution, self.longest - self.shortest)
        notices = self._check_evenness(step, rounding)
        doubt = (rounding + 8 * np.finfo(float).eps * self.magnitude) / span  # relative
        if header is not None:
            off = abs(measured / header - 1)
            if off <= max(doubt, 1e-9):
                return header, notices
            if off < 0.01:
                message = f"the times say {measured:.6g} Hz and the header {header:.6g} Hz; the header's rate is taken"
                return header, [*notices, Notice("rate-from-header", message, self.where)]
            message = (
                f"the header says {header:.6g} Hz, but the times {measured:.6g} Hz; the rate of the times is taken"
            )
            notices.append(Notice("rate-against-header", message, self.where))
        rate = fewest_digits(measured * (1 - doubt), measured * (1 + doubt))
        if doubt > 1e-6:
            message = (
                f"rounded to {self.resolution:.1g} s: any rate in {measured * (1 - doubt):.8g} to "
                f"{measured * (1 + doubt):.8g} Hz would do, {rate:.10g} Hz is taken; state another with --rate-hz"
            )
            notices.append(Notice("rounded-times", message, self.where, "warning" if doubt > MATTERS else "note"))
        return checked_rate(rate, self.where, "check the unit of the column, or state the rate with --rate-hz"), notices

    def _check_evenness(self, step: float, rounding: float) -> list[Notice]:
        """One uniform clock explains all times to a fraction of a step, or the recording is not one recording."""
        coarse = np.concatenate(self.coarse)
        line = self.first + step * _COARSE * np.arange(len(coarse))
        stray = float(np.max(np.abs(coarse - line)))
        if self.longest > 1.9 * step + 2 * rounding:
            raise RecordingError(
                f"{self.where}: the time jumps by {self.longest:.6g} s at {self.place(self.longest_at)} where a step "
                f"is {step:.6g} s; cut the file there, or state the rate with --rate-hz"
            )
        if stray > max(0.5 * step, 2 * rounding) and stray > 1e-4 * (self.last - self.first):
            raise RecordingError(
                f"{self.where}: uneven steps, up to {stray / step:.3g} samples away from a uniform clock; "
                "resample the recording, or state the rate with --rate-hz"
            )
        if self.longest - self.shortest > 0.1 * step + 2.1 * rounding or stray > 0.5 * step + 2 * rounding:
            message = (
                f"steps between {self.shortest:.4g} and {self.longest:.4g} s; "
                "the samples are taken as evenly spaced at their mean rate"
            )
            return [Notice("uneven-times", message, self.where)]
        return []

    def _compare_stated(self, stated: float) -> list[Notice]:
        span = self.last - self.first
        if self.n < 2 or span <= 0 or abs((self.n - 1) / span / stated - 1) < 1e-3:
            return []
        message = f"the times say {(self.n - 1) / span:.6g} Hz; the stated {stated:.6g} Hz is taken"
        return [Notice("rate-against-times", message, self.where)]


def checked_rate(rate: float, where: str, mending: str) -> float:
    """The rate, if a sampler of cuts or hits can have it."""
    if not SLOWEST <= rate <= FASTEST:
        raise RecordingError(
            f"{where}: a sample rate of {rate:.4g} Hz is not one of a cut or an impact test; {mending}"
        )
    return rate


def fewest_digits(low: float, high: float) -> float:
    """The number with the fewest significant digits in an interval, nearest to its middle.

    >>> fewest_digits(51198.9, 51200.7), fewest_digits(9999.8, 10000.3), fewest_digits(12345.67, 12345.671)
    (51200.0, 10000.0, 12345.67)
    """
    middle = (low + high) / 2
    exponent = floor(log10(middle))
    for digits in range(1, 13):
        candidate = round(middle, digits - 1 - exponent)
        if low <= candidate <= high:
            return candidate
    return middle


def unwrapped_midnights(seconds: np.ndarray, last: float | None) -> np.ndarray:
    """Times of day that run on over midnight.   seconds : (n,) s   last : the time before them, s"""
    steps = np.diff(seconds, prepend=seconds[0] if last is None else last)
    return seconds + _DAY * np.cumsum(np.round(-steps / _DAY).clip(min=0))


def _resolution(times: np.ndarray) -> float:
    """The power of ten of which all these times are multiples, s; 0 where there is none."""
    multiples = times * _DIGITS[:, np.newaxis]  # (decimals, time)
    off = np.abs(multiples - np.round(multiples))
    exact = (off <= 1e-3 + 4 * np.finfo(float).eps * np.abs(multiples)).all(axis=1)
    return 1 / _DIGITS[int(np.argmax(exact))] if exact.any() else 0.0
