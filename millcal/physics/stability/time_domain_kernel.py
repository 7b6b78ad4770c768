"""The cut step by step, compiled: modes propagated exactly, chips taken from the surface that the tooth before left.

`time_domain` lays out the tables, in the order of time, so that the loop only runs through them. One entry is one stretch of
edge in one step: its tooth and slice stand at one angle there, once in every revolution, and so the surface that it leaves
is kept under the number of the entry itself.

This module imports numba and so is imported where it is used.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

ROUNDS = 40  # of force and deflection answering each other, where the tip has a flexibility
SETTLED = 1e-12  # of the force, when they have


class Entries(NamedTuple):
    """The stretches of edge in cut, in the order of time over one revolution."""

    first: np.ndarray  # integer (stop + 1,): the entries of each stop
    sine: np.ndarray  # of the angle at mid-step, (entry,)
    cosine: np.ndarray  # (entry,)
    width: np.ndarray  # share of the depth, times that of the step in which it is engaged, (entry,)
    offset: np.ndarray  # radial reach beyond R, (entry,) m
    before: np.ndarray  # integer (entry, 4): entries of the tooth before, around the same angle
    tap: np.ndarray  # weight of each, (entry, 4)
    whole: bool  # the second of the four is at the same angle, and no other is needed


class Stops(NamedTuple):
    """The steps of one revolution at which something cuts or is looked at, and how the modes get to the next."""

    jump: np.ndarray  # integer (stop,): row of `ahead` and `push` that leads to the next stop
    steps: np.ndarray  # integer (jump,): how many steps that are
    travel: np.ndarray  # of the feed at mid-step, since the revolution began, (stop,) m
    sample: np.ndarray  # integer (stop,): where it is kept; -1: not
    ahead: np.ndarray  # e^(s t), complex (jump, mode)
    push: np.ndarray  # what a force held over the first of these steps adds, complex (jump, mode, 2)


class Tip(NamedTuple):
    """How the tip follows from the modal state at the start of a step."""

    at_start: np.ndarray  # 2 c, complex (mode, 2)
    at_middle: np.ndarray  # 2 c e^(s dt/2), complex (mode, 2)
    velocity: np.ndarray  # 2 c s e^(s dt/2), complex (mode, 2)
    answer: np.ndarray  # of the middle to a force held since the start, (2, 2) m/N
    rate: np.ndarray  # of its velocity, (2, 2) m/(N s)
    flexibility: np.ndarray  # (2, 2) m/N
    flexible: bool


class Edge(NamedTuple):
    """Force per width."""

    ktc: float  # N/m^2
    krc: float
    kte: float  # N/m
    kre: float
    ploughing: tuple[float, float]  # tangential and radial, per radial velocity, N s/m^2
    linear: bool  # waves alone: teeth never leave the cut, whatever the chip


@njit(cache=True)
def run(
    entries: Entries,
    stops: Stops,
    tip: Tip,
    edge: Edge,
    depth: float,
    travel: float,
    from_revolution: int,
    revolutions: int,
    state: np.ndarray,
    surface: np.ndarray,
    held: np.ndarray,
    kept: np.ndarray,
) -> None:
    """Whole revolutions of a cut; `state`, `surface` and `held` are carried on.

    travel : of the feed in one revolution, m   state : complex (mode,)   surface : (entry,) m   held : last force, (2,) N
    kept : displacement x, y at the start of the step and force x, y over it, of the last revolutions, (revolution, sample, 4)
    """
    modes = state.size
    damped = edge.ploughing[0] != 0.0 or edge.ploughing[1] != 0.0
    skipped = revolutions - kept.shape[0]
    fresh = np.empty(np.max(np.diff(entries.first)) + 1)
    fx, fy = held[0], held[1]
    for turn in range(revolutions):
        gone = (from_revolution + turn) * travel
        for stop in range(stops.jump.size):
            start, end = entries.first[stop], entries.first[stop + 1]
            before_x, before_y = fx, fy
            fx = fy = 0.0
            if end > start:
                x = tip.answer[0, 0] * before_x + tip.answer[0, 1] * before_y
                y = tip.answer[1, 0] * before_x + tip.answer[1, 1] * before_y
                vx = tip.rate[0, 0] * before_x + tip.rate[0, 1] * before_y
                vy = tip.rate[1, 0] * before_x + tip.rate[1, 1] * before_y
                for m in range(modes):
                    re, im = state[m].real, state[m].imag
                    x += tip.at_middle[m, 0].real * re - tip.at_middle[m, 0].imag * im
                    y += tip.at_middle[m, 1].real * re - tip.at_middle[m, 1].imag * im
                    if damped:
                        vx += tip.velocity[m, 0].real * re - tip.velocity[m, 0].imag * im
                        vy += tip.velocity[m, 1].real * re - tip.velocity[m, 1].imag * im
                feed = gone + stops.travel[stop]
                guess_x, guess_y = before_x, before_y
                for _ in range(ROUNDS if tip.flexible else 1):
                    fx = fy = 0.0
                    here_x = x + feed + tip.flexibility[0, 0] * guess_x + tip.flexibility[0, 1] * guess_y
                    here_y = y + tip.flexibility[1, 0] * guess_x + tip.flexibility[1, 1] * guess_y
                    for q in range(start, end):
                        s, c = entries.sine[q], entries.cosine[q]
                        if entries.whole:
                            left = surface[entries.before[q, 1]]
                        else:
                            left = 0.0
                            for i in range(4):
                                left += entries.tap[q, i] * surface[entries.before[q, i]]
                        reach = here_x * s + here_y * c + entries.offset[q]
                        chip = reach - left
                        if chip > 0.0 or edge.linear:
                            fresh[q - start] = reach
                            rate = vx * s + vy * c
                            tangential = edge.ktc * chip + edge.kte + edge.ploughing[0] * rate
                            radial = edge.krc * chip + edge.kre + edge.ploughing[1] * rate
                            width = entries.width[q]
                            fx -= width * (tangential * c + radial * s)
                            fy += width * (tangential * s - radial * c)
                        else:
                            fresh[q - start] = left
                    fx *= depth
                    fy *= depth
                    change = abs(fx - guess_x) + abs(fy - guess_y)
                    if change <= SETTLED * (abs(fx) + abs(fy)):
                        break
                    guess_x, guess_y = fx, fy
                for q in range(start, end):
                    surface[q] = fresh[q - start]
            place = stops.sample[stop]
            if place >= 0 and turn >= skipped:
                x = tip.flexibility[0, 0] * fx + tip.flexibility[0, 1] * fy
                y = tip.flexibility[1, 0] * fx + tip.flexibility[1, 1] * fy
                for m in range(modes):
                    x += (tip.at_start[m, 0] * state[m]).real
                    y += (tip.at_start[m, 1] * state[m]).real
                row = kept[turn - skipped, place]
                row[0], row[1], row[2], row[3] = x, y, fx, fy
            jump = stops.jump[stop]
            for m in range(modes):
                state[m] = stops.ahead[jump, m] * state[m] + stops.push[jump, m, 0] * fx + stops.push[jump, m, 1] * fy
            if stops.steps[jump] > 1:  # nothing cut in the last of them
                fx = fy = 0.0
    held[0], held[1] = fx, fy
