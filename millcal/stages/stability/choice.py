"""Which method makes a map where nobody says: the zero-order approximation where it is right, else one that knows the whole cut.

How wrong the mean of the cutting force is cannot be told from the engagement alone: with one mode and two teeth it promises ten
times too much in down milling at three quarters of the diameter and is right to a few percent in a slot. So it is held against
the rival that the dynamics allow, at a few speeds.
"""

from collections.abc import Sequence

import numpy as np

from millcal.data import Frf, Modes, Notice
from millcal.errors import IllPosedError
from millcal.stages.stability.method import Asked, Method, Progress
from millcal.stages.stability.methods import METHODS, OF_MODES
from millcal.units import to_shop

HELD_AT = 24  # speeds at which zero order is held against floquet,
HELD_AT_BY_LINES = (
    8  # and against frf, which takes up to a third of a second for one: a map of it is made only if asked for
)
TOO_DEEP = 0.2  # share by which it may promise more
SPEEDS = 0.05  # share of speeds at which it may do worse than that, as corners of two lobes do
ALWAYS_SMOOTH = 1.5  # teeth in cut, from which on no warning is given where nothing can be held against


def method_for(
    method: str | None, dynamics: Frf | Modes, modes: Modes | None, asked: Asked, progress: Progress
) -> tuple[Method, list[Notice]]:
    """The method put on the dynamics it needs, and what is to be told of the choice.

    method : as asked for, None: to be chosen   dynamics : what the map stands on   modes : fitted to it, if they are known
    """
    modes = dynamics if isinstance(dynamics, Modes) else modes
    if method not in (None, "zoa"):
        return METHODS[method](modes if method in OF_MODES and modes is not None else dynamics, asked), []
    first = METHODS["zoa"](dynamics, asked)
    try:
        rival = _rival(dynamics, modes, asked)
    except IllPosedError:
        rival = None
    lost = _left_out(asked)
    if rival is None:
        return first, lost or _unchecked(asked)
    if method is None and lost:
        what = f"{rival.name} is taken: {'; '.join(notice.message for notice in lost)}"
        return rival, [Notice("method", what, "stability.method", "note")]
    # of the same dynamics, so that the two differ in method alone
    same = METHODS["zoa"](modes, asked) if rival.name in OF_MODES and dynamics is not modes else first
    by_lines = rival.name == "frf"
    speeds = np.linspace(*asked.speeds, HELD_AT_BY_LINES if by_lines else HELD_AT)
    try:
        promised, true = _limits((same, rival), speeds, asked, progress)
    except IllPosedError:
        return first, lost or _unchecked(asked)
    deeper = promised / true
    worse = deeper > 1 + TOO_DEEP
    if np.mean(worse) <= SPEEDS:
        return first, lost
    i = int(np.argmax(deeper))
    many = np.count_nonzero(worse)
    found = (
        f"the zero-order limit, made of the mean force, is up to {deeper[i]:.2g} times too deep: at "
        f"{to_shop(speeds[i], 'x_rpm'):.0f} rpm it says {to_shop(promised[i], 'x_mm'):.3g} mm and {rival.name} "
        f"{to_shop(true[i], 'x_mm'):.3g} mm, and at {many} of {len(speeds)} speeds it is more than {TOO_DEEP:.0%} too deep"
    )
    if method is None and not by_lines:
        return rival, [Notice("method", f"{rival.name} is taken, since {found}", "stability.method", "note")]
    return first, [
        Notice(
            "zoa-unsafe",
            f"{found}; take {rival.name}{', or fit modes and take floquet' * by_lines}",
            "stability.method",
        ),
        *lost,
    ]


def _rival(dynamics: Frf | Modes, modes: Modes | None, asked: Asked) -> Method | None:
    """The method that knows what the zero-order one leaves out, if the dynamics allow one."""
    if modes is not None:
        return METHODS["floquet"](modes, asked)
    cut = asked.cut
    if cut.wind or cut.indentation or not cut.equal_pitch:
        return None
    return METHODS["frf"](dynamics, asked)


def _limits(methods: Sequence[Method], speeds: np.ndarray, asked: Asked, progress: Progress) -> list[np.ndarray]:
    """The first limit of each method, none deeper than all of them look.   returns (speed,) m each"""
    deepest = min(method.deepest for method in methods)
    return [np.minimum(method.table(speeds, asked.cut, progress)[:, 0], deepest) for method in methods]


def _left_out(asked: Asked) -> list[Notice]:
    """What the cutter or the cut has that the zero-order theory does not know at all."""
    notices = []
    if not asked.cut.equal_pitch:
        what = (
            "the zero-order limit knows one pitch: of the mean one it does not show what unequal pitch gains or loses"
        )
        notices.append(Notice("mean-pitch", what))
    if asked.cut.indentation:
        notices.append(Notice("no-process-damping", "the zero-order limit knows no process damping", "stability"))
    return notices


def _unchecked(asked: Asked) -> list[Notice]:
    """That nothing could be held against the zero-order limit."""
    teeth = asked.cut.in_cut
    if teeth >= ALWAYS_SMOOTH:
        return []
    what = (
        f"{teeth:.2f} teeth cut on average: period doubling and waves within the cut, which the zero-order theory leaves out, can "
        "make the limit several times less deep at some speeds, and nothing here shows where: fit modes and take floquet, else "
        "test deep pockets with a shallower cut first"
    )
    return [Notice("flip-lobes", what)]
