"""Cuts simulated in the time domain are judged as they are: rates over teeth, immersion, runout, noise and sensors.

A motion that comes back every turn but alternates from tooth to tooth may be strong runout near a resonance or a flip, and
passes from the one to the other without a step; there `not known` is right as well. So the rates that are held are those of
cuts that are plainly stable or chatter, where `not known` is a failure and a wrong verdict a worse one; the others are held by
themselves. The full grid is marked long and prints its table (pytest -s).
"""

from collections import Counter

import numpy as np
import pytest
from chattering_cuts import NATURAL, QUANTITIES, Cut, recorded

from millcal.stages.judge import judge_cut

RIGHT = {
    "stable": {"stable"},
    "chatter": {"chatter", "period-n"},
    "alternates": {"period-n", "chatter", "not known"},
    "unclear": {"stable", "not known", "period-n"},
}
PLAIN = ("stable", "chatter")
SPEEDS = (2500.0, 18000.0)  # rpm


def drawn(rng):
    """A cut near its limit, every third where flips are, with its motion; one that moves at all."""
    while True:
        teeth, immersion = int(rng.integers(1, 7)), float(rng.choice([0.05, 0.1, 0.25, 0.5, 1.0]))
        rpm = float(rng.uniform(3000, 15000))
        if rng.random() < 0.35:
            immersion = float(rng.choice([0.03, 0.05, 0.1]))
            rpm = 60 * NATURAL[0] / (teeth * (int(rng.integers(0, 4)) + 0.5)) * float(rng.uniform(0.93, 1.12))
        if not SPEEDS[0] < rpm < SPEEDS[1] or teeth * rpm / 60 > 1500:
            continue
        depth = float(np.exp(rng.uniform(np.log(0.15), np.log(1.5)))) * 0.5e-3 / immersion / teeth
        cut = Cut(teeth, rpm, depth, immersion, str(rng.choice(["up", "down"])), modes=int(rng.choice([1, 2])))
        runout, revolutions = float(rng.choice([0.0, 3e-6, 8e-6, 15e-6])), int(rng.choice([150, 250, 400]))
        motion = cut.run(runout, float(rng.uniform(0, 6.28)), revolutions, 1 + float(rng.uniform(-0.01, 0.01)))
        if np.std(motion.displacement[0][len(motion.time) // 2 :]) > 1e-3 * cut.feed:
            return cut, motion


def verdicts(rng, cuts):
    """(truth, quantity, verdict) of so many cuts by each sensor, and how far strong chatter's frequency is off."""
    found, off = [], []
    for _ in range(cuts):
        cut, motion = drawn(rng)
        truth = cut.truth(motion)
        for quantity in QUANTITIES:
            rate, noise = float(rng.choice([10_000.0, 12_800.0, 25_600.0])), float(rng.choice([0.01, 0.1, 0.3]))
            judged = judge_cut(recorded(motion, cut, quantity, rng, rate=rate, noise=noise))
            found.append((truth, quantity, judged.verdict))
            if quantity == "displacement" and truth == "chatter" and judged.verdict == "chatter":
                off.append(judged.chatter_frequency / strongest_line(motion) - 1)
    return found, np.array(off)


def strongest_line(motion):
    """Frequency of the largest line of the motion along x that is no harmonic of the spindle, Hz."""
    turn = motion.steps_per_revolution
    x = motion.displacement[0][-(len(motion.time) // 2 // turn) * turn :]
    dt = motion.time[1] - motion.time[0]
    size = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
    frequency, spindle = np.fft.rfftfreq(len(x), dt), 1 / (turn * dt)
    size[np.abs(frequency - np.rint(frequency / spindle) * spindle) < 3 / (len(x) * dt)] = 0.0
    return frequency[np.argmax(size)]


def table(found):
    kinds = sorted({truth for truth, _, _ in found})
    lines = [f"{'truth':12s}{'sensor':16s}{'cuts':>5s}{'right':>7s}  verdicts"]
    for truth in kinds:
        for quantity in QUANTITIES:
            told = Counter(verdict for t, q, verdict in found if (t, q) == (truth, quantity))
            count = sum(told.values())
            right = sum(n for verdict, n in told.items() if verdict in RIGHT[truth]) / max(count, 1)
            lines.append(f"{truth:12s}{quantity:16s}{count:5d}{right:7.1%}  {dict(told)}")
    return "\n".join(lines)


def share(found, *truths):
    """Of the cuts that are so, how many are judged right."""
    of = [verdict in RIGHT[truth] for truth, _, verdict in found if truth in truths]
    assert of, f"none of the cuts is {' or '.join(truths)}"
    return float(np.mean(of))


def wrong(found):
    """Of the cuts that are plainly stable or chatter, how many are called the other."""
    return float(np.mean([v not in RIGHT[t] and v != "not known" for t, _, v in found if t in PLAIN]))


def test_simulated_cuts_are_judged_right():
    found, off = verdicts(np.random.default_rng(17), 14)
    for truth in PLAIN:
        assert share(found, truth) >= 0.85, table(found)  # few cuts: one that nobody can tell costs much
    assert wrong(found) <= 0.05, table(found)
    assert np.mean(np.abs(off) < 3e-3) >= 0.9


@pytest.mark.long
def test_of_simulated_cuts_at_least_95_percent_are_judged_right():
    found, off = verdicts(np.random.default_rng(23), 400)
    print("\n" + table(found))
    print(
        f"plainly stable or chatter {share(found, *PLAIN):.1%} right, {wrong(found):.1%} wrong; chatter frequency of displacements "
        f"within 0.3 %: {np.mean(np.abs(off) < 3e-3):.1%}"
    )
    assert share(found, *PLAIN) >= 0.96, table(found)
    assert wrong(found) <= 0.005, table(found)
    assert share(found, "chatter") >= 0.95
    assert share(found, "stable") >= 0.95
    assert share(found, "alternates") >= 0.6
    assert np.mean(np.abs(off) < 3e-3) >= 0.95
