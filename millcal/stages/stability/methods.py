"""The methods of the stability map, each put on a structure: zoa, floquet, frf, time-domain.

zoa takes the mean of the cutting force over a revolution: fast, exact where many teeth cut at once, blind to period doubling.
floquet follows the waves through the cut with poles of the tip, so it needs modes. frf does the same with the lines of a
measured FRF and no model. time-domain cuts chip by chip, so that a tooth may leave the cut; it is slow and needs modes.

How deep the last three look is taken from what zoa says of the same structure, if nobody says it.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from millcal.data import Frf, Modes, Notice
from millcal.errors import IllPosedError
from millcal.physics.stability import zero_order
from millcal.physics.stability.moved_limits import moved_limits
from millcal.physics.stability.regeneration import HOPF, Crossings, Regeneration
from millcal.physics.stability.stable_depths import edge_table, edges_of
from millcal.physics.stability.zero_order_draws import limits_of_draws
from millcal.stages.stability.lines import tip_of_lines, usable_lines
from millcal.stages.stability.method import Asked, Method, Progress, Sampling, Solution
from millcal.stages.stability.modes import poles_of_modes, tip_of_modes
from millcal.stages.stability.spread import joined
from millcal.stages.stability.tip import Tip
from millcal.units import to_shop

RATIOS = 41  # K_rc / K_tc at which the zero-order limit is solved exactly for the band
FLOQUET_RATIOS = 13
FRF_RATIOS = 4
STRUCTURES = 1000  # draws of fitted modes, at most: of zoa, and of floquet where one mode moves,
FLOQUET_STRUCTURES = 200  # where several do,
SLOW_STRUCTURES = 60  # and with a helix or unequal pitch
# of `boundary`, for draws that spread much wider
SKETCH = {"depths": 12, "tolerance": 1e-3, "depth_tolerance": 1e-6, "heard": False}
BAND_SPEEDS = 120  # speeds of the band of the slower methods,
FRF_SPEEDS = 60  # of frf,
DRAWN_SPEEDS = 80  # where every draw is another structure,
SLOW_SPEEDS = 16  # and with a helix or unequal pitch
LOOKED = 200  # speeds at which zoa is asked how deep to look
DEEPER = 1.25  # times the deepest pockets of zoa
OVER_MINIMUM = 12.0  # times its lowest limit, at most,
OVER_DIAMETER = 3.0  # and times the cutter's diameter: pockets deeper than that are for no cutter
BEYOND_POINT = 1.5  # times the operating depth and the deepest test: as far at least
DISAGREE = 0.2  # share by which two methods may differ before it is told


def zoa(dynamics: Frf | Modes, asked: Asked) -> Method:
    """The zero-order approximation."""
    cut = asked.cut
    tip = _zero_order_tip(dynamics, asked)
    deepest, told = (np.inf, []) if asked.deepest is None else _as_asked(asked)

    def solve(speeds: np.ndarray, cut: Regeneration, progress: Progress) -> Solution:
        matrix = _mean_matrix(cut)
        limit = tip.solve(speeds, matrix)
        found = np.flatnonzero(limit.depth < deepest)
        kind, loses = np.full(len(found), HOPF), np.ones(len(found), bool)
        edges = Crossings(found, limit.depth[found], kind, limit.frequency[found], loses)
        return Solution(edges, edges)

    def with_noise(speeds: np.ndarray, cut: Regeneration, progress: Progress) -> Solution:
        assert tip.inverse_sd is not None
        matrix = _mean_matrix(cut)
        limit = tip.solve(speeds, matrix)
        return solve(speeds, cut, progress)._replace(inverse_sd=tip.inverse_sd(speeds, matrix, limit))

    def draw(sampling: Sampling) -> np.ndarray:
        assert tip.draws is not None
        assert tip.remainder is not None
        many = min(sampling.members, STRUCTURES)
        depth = limits_of_draws(
            sampling.speeds,
            list(tip.draws(sampling.rng, many)),
            np.array([_mean_matrix(cut.with_force(*force)) for force in _forces(cut, sampling.draws, many).tolist()]),
            cut.teeth,
            remainder=tip.remainder[0],
            remainder_power=tip.remainder[1].tolist(),
            band=tip.band,
            progress=sampling.progress,
        )
        return depth[:, :, np.newaxis]

    return Method(
        name="zoa",
        solve=solve,
        with_noise=None if tip.inverse_sd is None else with_noise,
        deepest=deepest,
        minimum=lambda cut: tip.minimum(_mean_matrix(cut)),
        ratios=RATIOS,
        further=lambda _: zoa(dynamics, replace(asked, deepest=None)),
        draw=None if tip.draws is None else draw,
        told=lambda speeds, solution, rng: _band_notices(tip, speeds, _mean_matrix(cut), solution),
        notices=(*tip.notices, *told),
    )


def floquet(dynamics: Frf | Modes, asked: Asked) -> Method:
    """Multipliers of the tooth period, from the poles of the tip."""
    from millcal.physics.stability import floquet as physics
    from millcal.physics.stability import one_direction

    modes = _modes(dynamics, "floquet")
    first = zoa(modes, asked)
    poles = poles_of_modes(modes)
    deepest, notices = _look_to(first, asked)

    def solve(speeds: np.ndarray, cut: Regeneration, progress: Progress) -> Solution:
        found = physics.boundary(speeds, poles.tip, cut, deepest=deepest, progress=progress)
        return Solution(found, edges_of(found, complete=True))

    def outline(speeds: np.ndarray, cut: Regeneration, progress: Progress) -> Solution:
        found = physics.boundary(speeds, poles.tip, cut, deepest=deepest, heard=False, progress=progress)
        return Solution(found, edges_of(found, complete=True))

    straight = asked.cut.equal_pitch and not asked.cut.wind and not asked.cut.indentation
    one_mode = straight and one_direction.common_direction([poles.tip]) is not None

    slow = bool(asked.cut.wind) or not asked.cut.equal_pitch  # tens of milliseconds a speed
    many = STRUCTURES if one_mode else SLOW_STRUCTURES if slow else FLOQUET_STRUCTURES
    many_speeds = SLOW_SPEEDS if slow else BAND_SPEEDS if poles.draws is None else DRAWN_SPEEDS

    def draw(sampling: Sampling) -> np.ndarray:
        assert poles.draws is not None
        tips = list(poles.draws(sampling.rng, min(sampling.members, many)))
        forces = _forces(asked.cut, sampling.draws, len(tips))
        if straight and one_direction.common_direction(tips) is not None:
            return one_direction.stable_edges(
                sampling.speeds, tips, asked.cut, forces, deepest=deepest, progress=sampling.progress
            )
        if slow:  # the edges above go with the first
            known = edge_table(outline(sampling.speeds, asked.cut, lambda share: None).edges, len(sampling.speeds))
            cuts = [asked.cut.with_force(*force) for force in forces.tolist()]
            others = list(zip(tips, cuts, strict=True))
            moved = moved_limits(sampling.speeds, known[:, 0], poles.tip, asked.cut, others, sampling.progress)
            none = np.isinf(known[:, 0])
            share = np.where(none, 1.0, moved) / np.where(none, 1.0, known[:, 0])
            return known * share[:, :, np.newaxis]
        tables = []
        for i, (tip, (ktc, krc)) in enumerate(zip(tips, forces, strict=True)):
            sampling.progress(i / len(tips))
            cut = asked.cut.with_force(float(ktc), float(krc))
            found = physics.boundary(sampling.speeds, tip, cut, deepest=deepest, **SKETCH)
            tables.append(edge_table(edges_of(found, complete=True), len(sampling.speeds)))
        return joined(tables)

    def check(speeds: np.ndarray, cut: Regeneration) -> Crossings:
        return edges_of(physics.all_crossings(speeds, poles.tip, cut, deepest=deepest), complete=True)

    return Method(
        name="floquet",
        solve=solve,
        outline=outline,
        deepest=deepest,
        refine=(1, 7) if slow else (2, 9),
        ratios=3 if slow else FLOQUET_RATIOS,
        further=lambda past: floquet(modes, replace(asked, deepest=past)),
        strengths=3 if asked.cut.wind or asked.cut.indentation else 1,
        draw=None if poles.draws is None else draw,
        band_speeds=None if one_mode else many_speeds,
        # a matrix that depends on the depth has no eigenvalues to go round with; of many teeth at once they are many
        check=None if asked.cut.wind or asked.cut.in_cut >= 1 else check,
        told=lambda speeds, solution, rng: _against(first, asked.cut, speeds, solution, deepest, "floquet"),
        notices=(*first.notices, *poles.notices, *notices, *_left_out_by_floquet(asked.cut)),
    )


def frf(dynamics: Frf | Modes, asked: Asked) -> Method:
    """The same as floquet with the lines of an FRF instead of poles."""
    from millcal.stages.stability.band_end import modes_at_the_end, moved_by_the_end
    from millcal.stages.stability.from_frf import NINETY_FIVE, crossings_of_lines, moved_by_noise, of_the_band

    if not isinstance(dynamics, Frf):
        raise IllPosedError(
            "stability.method: frf stands on the lines of a measured FRF, and there are only modes; give an FRF, or use floquet"
        )
    cut = asked.cut
    for wrong, what in (
        (not cut.equal_pitch, "unequal pitch"),
        (cut.wind, "a helix"),
        (cut.indentation, "process damping"),
    ):
        if wrong:
            raise IllPosedError(
                f"stability.method: frf knows nothing of {what}; fit modes (millcal modes) and use floquet, or leave it out"
            )
    first = zoa(dynamics, asked)
    deepest, notices = _look_to(first, asked)

    lines, _ = usable_lines(dynamics, asked.rigid)
    bare = lines._replace(variance=None)

    def solve(speeds: np.ndarray, cut: Regeneration, progress: Progress) -> Solution:
        found, _ = crossings_of_lines(bare, speeds, cut, deepest=deepest, progress=progress)
        return Solution(found, edges_of(found, complete=True))

    def with_noise(speeds: np.ndarray, cut: Regeneration, progress: Progress) -> Solution:
        found, ends = crossings_of_lines(lines, speeds, cut, deepest=deepest, progress=progress)
        noise = None if ends is None else (ends[0] - ends[1]) / (2 * NINETY_FIVE)
        return Solution(found, edges_of(found, complete=True), noise)

    def told(speeds: np.ndarray, solution: Solution, rng: np.random.Generator | None) -> list[Notice]:
        notices = _against(first, cut, speeds, solution, deepest, "frf")
        notices += moved_by_the_end(lines, speeds, cut, deepest)
        if rng is not None and solution.inverse_sd is not None:
            notices += moved_by_noise(dynamics, speeds, cut, deepest=deepest, rng=rng, rigid=asked.rigid)
        return notices

    return Method(
        name="frf",
        solve=solve,
        with_noise=with_noise,
        deepest=deepest,
        refine=(1, 7),
        ratios=FRF_RATIOS,
        further=lambda past: frf(dynamics, replace(asked, deepest=past)),
        band_speeds=FRF_SPEEDS,
        told=told,
        notices=(*first.notices, *of_the_band(lines), *modes_at_the_end(lines), *notices),
    )


def time_domain(dynamics: Frf | Modes, asked: Asked) -> Method:
    """Cuts simulated chip by chip; the limit is where one of them chatters."""
    from millcal.stages.stability.time_domain import crossings_in_time

    modes = _modes(dynamics, "time-domain")
    if asked.feed_per_tooth is None:
        raise IllPosedError("stability.feed_per_tooth_mm: the time domain cuts chips, so it needs the feed; give it")
    feed, (kte, kre) = asked.feed_per_tooth, asked.edge or (0.0, 0.0)
    first = zoa(modes, asked)
    poles = poles_of_modes(modes)
    deepest, notices = _look_to(first, asked)

    def solve(speeds: np.ndarray, cut: Regeneration, progress: Progress) -> Solution:
        found, simulated, told = crossings_in_time(
            poles.tip, cut, speeds, deepest=deepest, feed_per_tooth=feed, kte=kte, kre=kre, runout=asked.runout,
            progress=progress,
        )  # fmt: skip
        return Solution(found, edges_of(found), simulated=simulated, notices=tuple(told))

    return Method(
        name="time-domain",
        solve=solve,
        deepest=deepest,
        refine=(0, 0),
        banded=False,
        told=lambda speeds, solution, rng: _against(first, asked.cut, speeds, solution, deepest, "time-domain"),
        notices=(
            *first.notices,
            *poles.notices,
            *notices,
            Notice(
                "no-band",
                "the time domain gives a line: what is uncertain is not followed, whatever members says",
                level="note",
            ),
        ),
    )


def _zero_order_tip(dynamics: Frf | Modes, asked: Asked) -> Tip:
    if isinstance(dynamics, Modes):
        return tip_of_modes(dynamics, np.array(asked.speeds), asked.cut.teeth, asked.rigid)
    return tip_of_lines(dynamics, asked.cut.teeth, asked.rigid)


def _mean_matrix(cut: Regeneration) -> np.ndarray:
    return zero_order.mean_cutting_matrix(cut.ktc, cut.krc, teeth=cut.teeth, entry=cut.entry, leave=cut.leave)


def _forces(cut: Regeneration, draws: np.ndarray | None, many: int) -> np.ndarray:
    """K_tc and K_rc of as many draws, the mean's where they are exact.   returns (many, 2) N/m^2"""
    known = np.array([[cut.ktc, cut.krc]]) if draws is None else draws
    return known[np.arange(many) % len(known)]


def _modes(dynamics: Frf | Modes, method: str) -> Modes:
    if isinstance(dynamics, Modes):
        return dynamics
    raise IllPosedError(
        f"stability.method: {method} follows modes, and there is only an FRF; fit them first (millcal modes), or use frf"
    )


def _look_to(first: Method, asked: Asked) -> tuple[float, list[Notice]]:
    """How deep to look: as asked, else past the deepest pockets of the zero-order limit, the operating point and the tests."""
    if asked.deepest is not None:
        return _as_asked(asked)
    low, high = asked.speeds
    found = first.solve(np.linspace(low, high, LOOKED), asked.cut, lambda share: None).edges.depth
    wanted = [BEYOND_POINT * asked.least_depth]
    if len(found):
        pockets = min(DEEPER * float(found.max()), OVER_MINIMUM * float(found.min()))
        wanted.append(min(pockets, max(OVER_DIAMETER * 2 * asked.cut.radius, DEEPER * float(found.min()))))
    deepest = max(wanted)
    if not deepest > 0:
        raise IllPosedError(
            "stability.deepest_mm: the zero-order limit is nowhere, so nothing says how deep to look; give the depth"
        )
    what = f"looked for limits down to {_mm(deepest)} mm, as far as pockets of the zero-order limit are of use; deepest_mm sets it"
    return deepest, [Notice("deepest", what, "stability.deepest_mm", "note")]


def _as_asked(asked: Asked) -> tuple[float, list[Notice]]:
    """The depth asked for, or what the operating point and the tests need to be told stable from."""
    assert asked.deepest is not None
    least = asked.least_depth
    if asked.deepest >= least:
        return asked.deepest, []
    what = (
        f"{_mm(asked.deepest)} mm do not reach the operating point or the test cuts; limits are looked for down to "
        f"{_mm(least)} mm"
    )
    return least, [Notice("deepest", what, "stability.deepest_mm")]


def _against(
    first: Method, cut: Regeneration, speeds: np.ndarray, solution: Solution, deepest: float, name: str
) -> list[Notice]:
    """Where the first limit is another than that of the zero-order method."""
    own, other = (
        np.minimum(edge_table(edges, len(speeds))[:, 0], deepest)
        for edges in (solution.edges, first.solve(speeds, cut, lambda share: None).edges)
    )
    apart = np.abs(np.log(own / other))
    many = int(np.count_nonzero(apart > np.log1p(DISAGREE)))
    if not many:
        return []
    i = int(np.argmax(apart))
    what = (
        f"{name} and the zero-order limit differ by more than {DISAGREE:.0%} at {many} of {len(speeds)} speeds, most at "
        f"{to_shop(speeds[i], 'x_rpm'):.0f} rpm, where {name} says {_mm(own[i])} and zero order {_mm(other[i])} mm"
    )
    return [Notice("methods-disagree", what, level="note")]


def _left_out_by_floquet(cut: Regeneration) -> list[Notice]:
    notices = []
    if cut.in_cut < 0.5:
        what = (
            "a tooth that leaves the cut is outside the linear theory: beside a limit a cut may go on chattering that a knock "
            "has begun (method time-domain)"
        )
        notices.append(Notice("loss-of-contact", what, level="note"))
    return notices


def _band_notices(tip: Tip, speeds: np.ndarray, nominal: np.ndarray, solution: Solution) -> list[Notice]:
    """Where the usable band of the FRF may hide a lower limit."""
    notices: list[Notice] = []
    if tip.band is None:
        return notices
    depth = edge_table(solution.edges, len(speeds))[:, 0]
    band = f"{tip.band[0]:.0f} to {tip.band[1]:.0f} Hz, {tip.band_of}"
    none = int(np.count_nonzero(np.isinf(depth)))
    if none:
        what = f"{none} of {len(depth)} speeds have no chatter frequency from {band}; what limits them is not shown"
        notices.append(Notice("band-limited", what))
    if tip.beyond is not None:
        beyond = tip.beyond(speeds, nominal)
        lower = (beyond.depth < 0.95 * depth) & (beyond.frequency > tip.band[1])
        if lower.any():
            at = np.median(beyond.frequency[lower])
            what = (
                f"limits count chatter from {band}; lines above it, if they can be trusted, lower the limit at "
                f"{np.count_nonzero(lower)} of {len(depth)} speeds, by chatter about {at:.0f} Hz; hit with a harder tip"
            )
            notices.append(Notice("band-limited", what))
    return notices


def _mm(depth: float) -> str:
    return f"{to_shop(depth, 'x_mm'):.3g}"


OF_MODES = ("floquet", "time-domain")

METHODS: dict[str, Callable[[Frf | Modes, Asked], Method]] = {
    "zoa": zoa,
    "floquet": floquet,
    "frf": frf,
    "time-domain": time_domain,
}
