"""Stability map: limit depth against spindle speed, with all that follows from it.

A method (`methods`) gives the depths at which stability is lost and comes back, speed by speed. From these, whatever the
method, come the band and the probabilities (`spread`), the best speeds (`pockets`) and the operating point (`operating`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from millcal.data import CutTests, Frf, Modes, Notice, OperatingPoint, Posterior, StabilityMap
from millcal.errors import IllPosedError
from millcal.physics.cutter import Cutter, CuttingConditions, engagement
from millcal.physics.mean_torque import mean_torque
from millcal.physics.stability.regeneration import Crossings, Regeneration
from millcal.physics.stability.stable_depths import edge_table
from millcal.stages.stability.choice import method_for
from millcal.stages.stability.coefficients import cutting_draws, edge_force, tangential_law
from millcal.stages.stability.cuts import held_against, on_speeds, simulated_over
from millcal.stages.stability.method import Asked, Method, Sampling, Solve
from millcal.stages.stability.methods import DEEPER, METHODS, OVER_MINIMUM
from millcal.stages.stability.operating import SAFE, Columns, judged
from millcal.stages.stability.pockets import HELD, around, best_speeds, held, pockets, refined, safest
from millcal.stages.stability.possible import NO_CUTTER, doubtful, doubtful_limit, refuse_impossible
from millcal.stages.stability.spread import PAST, Spread, band_speeds, spread_of
from millcal.units import to_shop

DEPTHS = 80  # of a map of probabilities
FEWEST, FOR_95 = 2, 39  # draws for any band, and for one of 95 %: the ends of n draws hold (n - 1) / (n + 1)
ALIKE = 1e-3  # share by which two ways to the same limit may differ
NEAR = 5  # speeds about that of the point at which another cutter is looked at
CAUTION = (
    "come to these depths from below: they are those of small vibrations, and in a cut so short a knock throws a tooth out, "
    "so that some cuts chatter before their limit (method time-domain, --simulate-points)"
)
HELIX = np.radians(30.0)  # of a cutter that is held against one whose period doubles


def map_stability(
    dynamics: Frf | Modes,
    posterior: Posterior | tuple[float, float],
    *,
    teeth: int,
    diameter: float,
    radial_depth: float | None,
    direction: str,
    spindle_speed: tuple[float, float],
    feed_per_tooth: float | None = None,
    pitch: Sequence[float] | None = None,
    helix: float = 0.0,
    runout: tuple[float, float] = (0.0, 0.0),
    rigid: str = "",
    method: str | None = None,
    modes: Modes | None = None,
    points: int = 400,
    deepest: float | None = None,
    indentation: float = 0.0,
    indentation_friction: float = 0.3,
    edge: tuple[float, float] | None = None,
    members: int = 2000,
    probability: bool | int = False,
    operating_point: tuple[float, float] | None = None,
    tests: CutTests | None = None,
    simulate: tuple[int, int] | None = None,
    rng: np.random.Generator | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> StabilityMap:
    """Limit depth over a range of spindle speeds, the best speeds in it, and the operating point among them.

    dynamics : an FRF with driving points along x and y at one point, or modes, given along x and y or fitted to such an FRF
    posterior : coefficients, or (K_tc, K_rc) in N/m^2 taken as exact
    diameter, radial_depth, feed_per_tooth : m   spindle_speed : (lowest, highest) rad/s   pitch : (tooth,) rad   helix : rad
    runout : (c0, s0) m as in the time domain, which alone counts it towards stability
    rigid : axes that may be missing from `dynamics`, "x" or "y", because the user knows them to be rigid
    method : zoa, floquet (needs modes), frf (needs an FRF), time-domain (needs modes); None: zoa where it is right (`choice`)
    modes : those fitted to an FRF that is given, for methods that need them
    deepest : m, how deep to look; None: from the zero-order limit, the operating point and the tests
    indentation, indentation_friction : C in N/m and mu of process damping; 0: none
    edge : (K_te, K_re) N/m, for torque, power and the time domain; None: those of the coefficients, if they have them
    members : draws for the band and the probabilities   probability : a map of them, True or its number of depths
    operating_point : (rad/s, m)   tests : cuts made, drawn over the map and held against it
    simulate : (speeds, depths) of points cut in the time domain, whatever the method; with an operating point also a line of
    depths at its speed   rng : needed for a band
    """
    if method is not None and method not in METHODS:
        raise ValueError(f"{method=} is none of {', '.join(METHODS)}")
    low, high = spindle_speed
    progress = progress or (lambda share, label: None)
    radial_depth = diameter if direction == "slot" or radial_depth is None else radial_depth
    refuse_impossible(
        spindle_speed=spindle_speed,
        points=points,
        diameter=diameter,
        radial_depth=radial_depth,
        deepest=deepest,
        operating_point=operating_point,
    )
    conditions = CuttingConditions(high, feed_per_tooth or 0.0, 1.0, radial_depth, direction)
    entry, leave = engagement(conditions, diameter)
    if leave - entry <= 0:
        raise IllPosedError("stability.radial_depth_mm: the cutter is not engaged; give a radial depth above zero")
    mean_chip = (feed_per_tooth or 0.0) * (np.cos(entry) - np.cos(leave)) / (leave - entry)
    (ktc, krc), draws, notices = cutting_draws(posterior, mean_chip, members, rng)
    edge = edge_force(posterior) if edge is None else edge
    notices += doubtful(
        ktc=float(ktc),
        krc=float(krc),
        edge=edge,
        spindle_speed=spindle_speed,
        diameter=diameter,
        radial_depth=radial_depth,
        feed_per_tooth=feed_per_tooth,
        deepest=deepest,
        indentation=indentation,
        friction=indentation_friction,
        operating_point=operating_point,
    )
    cutter = Cutter(
        diameter,
        teeth,
        helix,
        None if pitch is None else tuple(float(part) for part in pitch),
        float(np.hypot(*runout)),
        float(np.arctan2(runout[1], runout[0])),
    )
    cut = Regeneration(
        teeth,
        entry,
        leave,
        float(ktc),
        float(krc),
        cutter.pitch,
        float(cutter.helix_lag(np.array(1.0))),
        indentation,
        indentation_friction,
        diameter / 2,
    )
    marked = [] if operating_point is None else [operating_point[0]]
    depths = [0.0, *([] if operating_point is None else [operating_point[1]])]
    if tests is not None:  # as far as they lie on the map: one odd row is not to rule how deep it looks
        on_map = on_speeds(tests, low, high) & (tests.axial_depth <= NO_CUTTER * diameter)
        depths += tests.axial_depth[on_map].tolist()
    asked = Asked(
        cut=cut,
        speeds=(min([low, *marked]), max([high, *marked])),
        least_depth=max(depths),
        deepest=deepest,
        rigid=rigid,
        feed_per_tooth=feed_per_tooth,
        edge=edge,
        runout=runout,
    )
    chosen, told = method_for(method, dynamics, modes, asked, lambda share: progress(0.1 * share, "method"))
    notices += told

    speeds = np.linspace(low, high, points)
    wanted = (
        rng is not None
        and members > 1
        and chosen.banded
        and bool(chosen.draw or chosen.with_noise or draws is not None)
    )
    # A limit just past the deepest that is told may be as uncertain as one just above it.
    further = chosen.further(PAST * chosen.deepest) if wanted and chosen.further is not None else chosen
    closely = further.with_noise if wanted and further.with_noise else chosen.solve
    looked = closely(speeds, cut, lambda share: progress(0.1 + 0.3 * share, "limit"))
    solution = looked._replace(crossings=_down_to(looked.crossings, chosen), edges=_down_to(looked.edges, chosen))
    table = edge_table(solution.edges, points)

    def edges_at(some: np.ndarray) -> np.ndarray:
        return chosen.table(some, cut)

    tops = pockets(lambda some: edges_at(some)[:, 0], speeds, table[:, 0], chosen.deepest, chosen.refine)
    extra = np.concatenate([around(tops, low, high), marked])
    if operating_point is not None and _outside(operating_point[0], speeds):
        _refuse_crowded(chosen, cut, operating_point[0])
    beside, noise, told = _beside(chosen, closely, cut, extra)
    notices += told
    deep = _stacked(edge_table(looked.edges, points), edge_table(beside, len(extra)))
    beside = _down_to(beside, chosen)
    beside_table = edge_table(beside, len(extra))
    everywhere = np.concatenate([speeds, extra])
    both = _stacked(table, beside_table)

    spread = None
    if wanted and rng is not None:
        dear = chosen.draw is not None or draws is not None  # else the noise is known at every speed
        at = band_speeds(speeds, table[:, 0], extra, chosen.band_speeds if dear else None)
        places, once = np.unique(everywhere, return_index=True)
        nominal = _known_past(deep[once], places, further, cut) if further is not chosen else deep[once]
        known = (
            None if solution.inverse_sd is None or noise is None else np.concatenate([solution.inverse_sd, noise])[once]
        )
        sampling = Sampling(at, members, draws, rng, lambda share: progress(0.42 + 0.5 * share, "band"))
        spread = spread_of(further, cut, places, nominal, known, sampling, chosen.deepest)
    notices += _drawn(spread, members, draws, chosen, rng)
    band = None if spread is None else spread.band(everywhere)
    limits = both[:, 0]
    picture = _picture(limits, chosen.deepest, asked)

    width = None if feed_per_tooth is None else radial_depth * feed_per_tooth * teeth / (2 * np.pi)
    order = np.argsort(everywhere, kind="stable")
    order = order[(everywhere[order] >= low) & (everywhere[order] <= high)]
    ascending, below = everywhere[order], limits[order] if band is None else np.minimum(band[0], limits)[order]
    tops_depth = held(ascending, limits[order], tops)
    if band is not None and len(tops):
        holds = (held(ascending, depth, ascending) for depth in (limits[order], below))
        tops = safest(tops, ascending, *holds, chosen.deepest)
        moved, _, told = _beside(chosen, chosen.solve, cut, around(tops, low, high))
        notices += told
        seen = edge_table(moved, 3 * len(tops))[:, 0].reshape(3, -1).min(axis=0)
        tops_depth = np.minimum(seen, held(ascending, limits[order], tops))
    best = best_speeds(
        tops,
        np.minimum(tops_depth, chosen.deepest),
        None if band is None else held(ascending, below, tops),
        spread,
        width=width,
        torque=_torque_per_depth(tangential_law(posterior, edge), cutter, conditions),
        column=(ascending, below),
    )
    operating = None
    if operating_point is not None:
        safe = np.minimum(SAFE * limits[order] if band is None else below, picture)
        within = ascending[0] <= operating_point[0] <= ascending[-1]
        here = float(held(ascending, safe, np.array(marked))[0]) if within else np.inf
        runnable = held(ascending, safe, speeds)
        columns = Columns(speeds, table, runnable, here, picture, edges_at if chosen.refine[0] else None)
        own = _of_one(beside, len(extra) - 1)
        notices += _outside(operating_point[0], speeds)
        operating = _operating(chosen, cut, operating_point, own, columns, best, spread, cutter)
    first = solution.edges.first(points)
    on_map = (everywhere >= speeds[0]) & (everywhere <= speeds[-1])  # the operating point may lie beside it
    minimum = _minimum(chosen, cut, everywhere[on_map], limits[on_map])
    notices += doubtful_limit(minimum[0], diameter)
    probabilities = _probabilities(spread, speeds, probability, picture)
    if probability and probabilities is None:
        why = (
            f"{chosen.name} does not follow what is uncertain (methods zoa, floquet and frf do)" if not chosen.banded
            else "nothing was drawn" if members < FEWEST or rng is None
            else "nothing is known to be uncertain"
        )  # fmt: skip
        notices.append(Notice("no-probability", f"{why}, so there is no probability to map", "stability.probability"))
    if tests is not None:
        tests, told = held_against(tests, speeds, chosen, cut)
        notices += told
    simulated = solution.simulated
    if simulate is not None:
        simulated, told = simulated_over(
            dynamics if modes is None else modes,
            asked,
            speeds,
            simulate,
            picture,
            operating_point,
            lambda share: progress(0.92 + 0.08 * share, "cuts"),
        )
        notices += told
    progress(1.0, "limit")
    return StabilityMap(
        spindle_speed=speeds,
        limit_depth=table[:, 0],
        chatter_frequency=first.frequency,
        limit_kind=first.kind,
        lobe=_lobes(first, speeds, teeth),
        crossing_speed=speeds[solution.crossings.speed],
        crossing_depth=solution.crossings.depth,
        crossing_kind=solution.crossings.kind,
        crossing_frequency=solution.crossings.frequency,
        crossing_loses=solution.crossings.loses,
        operating=operating,
        limit_low=None if band is None else band[0, :points],
        limit_high=None if band is None else band[1, :points],
        draws=None if spread is None else spread.members,
        probability=None if probabilities is None else probabilities[1],
        probability_depth=None if probabilities is None else probabilities[0],
        method=chosen.name,
        deepest=chosen.deepest,
        teeth=teeth,
        radial_depth=radial_depth,
        diameter=diameter,
        direction=direction,
        feed_per_tooth=feed_per_tooth,
        absolute_minimum=minimum[0],
        absolute_minimum_frequency=minimum[1],
        absolute_minimum_speed=minimum[2],
        best=best,
        tests=tests,
        simulated=simulated,
        notices=_once([
            *notices,
            *chosen.notices,
            *solution.notices,
            *(chosen.told(speeds, solution, rng) if chosen.told else []),
            *_feed_notices(feed_per_tooth),
        ]),
    )  # fmt: skip


def _beside(
    chosen: Method, solve: Solve, cut: Regeneration, speeds: np.ndarray
) -> tuple[Crossings, np.ndarray | None, list[Notice]]:
    """Edges at the speeds that matter most, where a method has a second way to them by that; and what the first one missed."""
    solution = solve(speeds, cut, lambda share: None)
    if chosen.check is None or not len(speeds):
        return solution.edges, solution.inverse_sd, []
    checked = chosen.check(speeds, cut)
    one, other = (np.minimum(edge_table(e, len(speeds))[:, 0], chosen.deepest) for e in (solution.edges, checked))
    lower = other <= one * (1 + ALIKE)  # of two ways to one limit the one that promises less is believed
    missed = np.flatnonzero(other < one * (1 - ALIKE))
    notices = []
    if len(missed):
        i = missed[np.argmin(other[missed] / one[missed])]
        what = (
            f"at {to_shop(speeds[i], 'x_rpm'):.0f} rpm the limit is {to_shop(other[i], 'x_mm'):.3g} mm, in a pocket that "
            "the map had missed; there may be others between the speeds shown"
        )
        notices.append(Notice("pocket-missed", what))
    believed = [
        Crossings(*(part[chosen_here] for part in edges))
        for edges, whose in ((checked, lower), (solution.edges, ~lower))
        for chosen_here in [whose[edges.speed]]
    ]
    together = Crossings(*(np.concatenate(parts) for parts in zip(*believed, strict=True)))
    order = np.lexsort((together.depth, together.speed))
    return Crossings(*(part[order] for part in together)), solution.inverse_sd, notices


def _drawn(
    spread: Spread | None, members: int, draws: np.ndarray | None, chosen: Method, rng: np.random.Generator | None
) -> list[Notice]:
    """Where the draws are other than were asked for, or too few for what is said of them."""
    if rng is None or not chosen.banded:
        return []
    if members == 1:
        what = f"one draw makes no band: ask for {FOR_95} or more, or for 0 to have none"
        return [Notice("draws", what, "stability.members")]
    if spread is None:
        return []
    made, notices = spread.members, []
    asked = members if draws is None else min(members, len(draws))
    if made < asked:
        what = f"band and probabilities stand on {made} draws instead of {members}: each of them is another structure to solve"
        notices.append(Notice("draws", what, "stability.members", "note"))
    if made < FOR_95:
        held = (made - 1) / (made + 1)
        what = f"{made} draws hold {held:.0%} between their ends, and no more does the band; 95 % need {FOR_95}"
        notices.append(Notice("few-draws", what, "stability.members"))
    return notices


def _down_to(crossings: Crossings, chosen: Method) -> Crossings:
    """Those that are told."""
    return Crossings(*(part[crossings.depth <= chosen.deepest] for part in crossings))


def _known_past(nominal: np.ndarray, speeds: np.ndarray, further: Method, cut: Regeneration) -> np.ndarray:
    """Edges, with what lies past the deepest where nothing lies above it.   nominal : (speed, edge) m"""
    without = np.flatnonzero(np.isinf(nominal[:, 0]))
    if not len(without):
        return nominal
    past = further.table(speeds[without], cut)
    both = _stacked(nominal, past)
    both[without] = both[len(nominal) :]
    return both[: len(nominal)]


def _stacked(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Two tables of edges, one below the other.   returns (speed, edge)"""
    wide = max(one.shape[1], other.shape[1])
    return np.concatenate([
        np.pad(table, ((0, 0), (0, wide - table.shape[1])), constant_values=np.inf) for table in (one, other)
    ])  # fmt: skip


def _of_one(crossings: Crossings, speed: int) -> Crossings:
    """The crossings of one speed, as that of speed 0."""
    own = Crossings(*(part[crossings.speed == speed] for part in crossings))
    return own._replace(speed=np.zeros(len(own.depth), int))


def _operating(
    chosen: Method,
    cut: Regeneration,
    point: tuple[float, float],
    own: Crossings,
    columns: Columns,
    best: tuple,
    spread: Spread | None,
    cutter: Cutter,
) -> OperatingPoint:
    def others() -> list[tuple[str, float]]:
        """Cutters of other teeth or with a helix, and the least of their limits about the speed of the point."""
        near = point[0] * np.linspace(1 - HELD, 1 + HELD, NEAR)
        wound = replace(cut, wind=float(np.tan(HELIX)) / cutter.radius)
        tried = [(f"a cutter of {n} teeth" if n > 1 else "a cutter of one tooth", replace(cut, teeth=n, pitch=None))
                 for n in (cut.teeth + 1, cut.teeth - 1) if n]  # fmt: skip
        if abs(cut.wind) < wound.wind / 2:
            tried.append((f"a helix of {np.degrees(HELIX):.0f} deg", wound))
        found = []
        for what, other in tried:
            depth = chosen.table(near, other)[:, 0]
            found.append((what, float(depth.min())))
        return sorted(found, key=lambda one: -one[1])

    limit = float(edge_table(own, 1)[0, 0])
    leaves = cut.in_cut < 0.5 and chosen.name != "time-domain"
    return judged(
        point,
        own,
        limit,
        columns,
        best,
        spread,
        others if chosen.name == "floquet" else None,
        CAUTION if leaves else "",
    )


def _refuse_crowded(chosen: Method, cut: Regeneration, speed: float) -> None:
    """Refuse a speed of the operating point that the method cannot solve, in its name: those of the map it can."""
    try:
        chosen.solve(np.array([speed]), cut, lambda share: None)
    except IllPosedError as problem:
        why = str(problem).partition(": ")[2].partition(";")[0]
        raise IllPosedError(
            f"stability.spindle_speed_rpm: the operating point (--operating): {why}; judge a cut at a higher speed, or use zoa"
        ) from None


def _outside(speed: float, speeds: np.ndarray) -> list[Notice]:
    """That nothing is known between the operating point and the map."""
    low, high = speeds[[0, -1]]
    if low * (1 - ALIKE) <= speed <= high * (1 + ALIKE):
        return []
    what = (
        f"the operating point, {to_shop(speed, 'x_rpm'):.0f} rpm, lies outside the map, {to_shop(low, 'x_rpm'):.0f} to "
        f"{to_shop(high, 'x_rpm'):.0f} rpm: speeds nearer to it were not looked at; widen the map to be advised of them"
    )
    return [Notice("operating-outside", what, "stability.rpm")]


def _lobes(first: Crossings, speeds: np.ndarray, teeth: int) -> np.ndarray:
    """Whole waves between two teeth, -1 where there is no limit."""
    waves = first.frequency * 2 * np.pi / (teeth * speeds)
    return np.where(first.loses, np.floor(np.where(first.loses, waves, 0.0) + 1e-9), -1).astype(int)


def _minimum(chosen: Method, cut: Regeneration, speeds: np.ndarray, limit: np.ndarray) -> tuple[float, float, float]:
    """The lowest limit: of every speed where the method knows it, else over the range of the map, and where in it.

    returns m, Hz, rad/s
    """
    if chosen.minimum is not None:
        return *chosen.minimum(cut), np.nan
    if not np.isfinite(limit).any():
        return np.inf, np.nan, np.nan

    def first(some: np.ndarray) -> Crossings:
        return chosen.solve(some, cut, lambda share: None).edges.first(len(some))

    order = np.argsort(speeds, kind="stable")
    place = int(np.argmin(limit[order]))
    low, lowest, high = (speeds[order[[min(max(place + k, 0), len(order) - 1)]]] for k in (-1, 0, 1))
    at = refined(lambda some: -first(some).depth, lowest, low, high, chosen.refine)
    found = first(at)
    return float(found.depth[0]), float(found.frequency[0]), float(at[0])


def _torque_per_depth(law, cutter: Cutter, conditions: CuttingConditions) -> float | None:
    """Mean torque over the axial depth, N; None without a law or a feed."""
    if law is None or not conditions.feed_per_tooth > 0:
        return None
    depth = cutter.diameter / 4  # the offset winds with the helix, so that the torque is not quite in proportion to it
    return mean_torque(law, cutter, replace(conditions, axial_depth=depth)) / depth


def _picture(limit: np.ndarray, deepest: float, asked: Asked) -> float:
    """How deep a picture of the map goes, m."""
    if np.isfinite(deepest):
        return deepest
    found = limit[np.isfinite(limit)]
    most = min(DEEPER * found.max(), OVER_MINIMUM * found.min()) if len(found) else 0.0
    return float(max(most, 1.5 * asked.least_depth)) or 10e-3


def _probabilities(
    spread: Spread | None, speeds: np.ndarray, wanted: bool | int, deepest: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Depths and P_stable over them, (depth,) and (depth, speed)."""
    if spread is None or not wanted:
        return None
    many = DEPTHS if wanted is True else int(wanted)
    depth = deepest * np.arange(1, many + 1) / many
    return depth, spread.share(depth, speeds)


def _once(notices: list[Notice]) -> tuple[Notice, ...]:
    """Each notice once, in their order."""
    return tuple({(notice.code, notice.where, notice.message): notice for notice in notices}.values())


def _feed_notices(feed_per_tooth: float | None) -> list[Notice]:
    if feed_per_tooth is not None:
        return []
    return [
        Notice(
            "no-feed",
            "no feed per tooth: best speeds are ranked by depth times speed, and removal rates are not known",
            "stability.feed_per_tooth_mm",
        )
    ]
