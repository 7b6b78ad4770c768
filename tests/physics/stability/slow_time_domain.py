"""A cut in the time domain the obvious way: real modes by matrix exponentials, one tooth and slice after the other."""

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.linalg import expm


def simulate(speed, depth, modes, cut, *, feed, kte=0.0, kre=0.0, runout=(0.0, 0.0), revolutions, steps, slices, kick):
    """Displacement and force, (2, step) each.

    modes : of (natural frequency Hz, damping ratio, mass-normalised shape (2,))
    """
    turn, dt = 2 * np.pi / steps, 2 * np.pi / steps / speed
    full, half = [], []
    for frequency, zeta, _ in modes:
        w = 2 * np.pi * frequency
        a = np.array([[0, 1, 0], [-(w**2), -2 * zeta * w, 1], [0, 0, 0]])  # q, q', force of the mode
        full.append(expm(a * dt))
        half.append(expm(a * dt / 2))
    shape = np.array([p for *_, p in modes])
    motion = [np.array([0.0, p @ np.asarray(kick)]) for p in shape]
    pitch = np.full(cut.teeth, 2 * np.pi / cut.teeth) if cut.pitch is None else np.array(cut.pitch)
    behind = np.concatenate([[0.0], np.cumsum(pitch)[:-1]])
    heights = (np.arange(slices) + 0.5) * depth / slices
    low, high = int(cut.entry / turn) - 2, int(np.ceil(cut.leave / turn)) + 3
    surface = {}  # of tooth, slice and place; one place is one step wide, shifted by what the lag is off a whole step
    even = np.allclose(behind / turn, np.round(behind / turn), atol=1e-9)

    def off(tooth, i):
        lag = round((behind[tooth] + cut.wind * heights[i]) / turn, 9)
        return lag, lag - np.floor(lag)

    def left_by(tooth, i, place, travelled):
        if (tooth, i, place) not in surface:  # a rigid tool in the revolution before
            lag, part = off(tooth, i)
            at = (place - part + 0.5) * turn
            if even:
                at = (min(at + turn / 2, cut.leave) + max(at - turn / 2, cut.entry)) / 2
            radial = runout[0] * np.cos(lag * turn) - runout[1] * np.sin(lag * turn)
            step = (place + int(np.floor(lag))) % steps
            surface[tooth, i, place] = feed * cut.teeth * ((step + 0.5) / steps - 1) * np.sin(at) + radial
        return surface[tooth, i, place]

    force = np.zeros(2)
    displacements, forces = [], []
    for k in range(revolutions * steps):
        travelled = feed * cut.teeth * (k + 0.5) / steps
        middle = sum(p * (h @ np.array([*q, p @ force]))[0] for p, h, q in zip(shape, half, motion, strict=True))
        now = np.zeros(2)
        fresh = {}
        for tooth in range(cut.teeth):
            for i in range(slices):
                lag, part = off(tooth, i)
                place = (k - int(np.floor(lag)) - low) % steps + low
                if not low <= place <= high:
                    continue
                angle = (place + 0.5 - part) * turn
                share = np.clip((min(angle + turn / 2, cut.leave) - max(angle - turn / 2, cut.entry)) / turn, 0.0, 1.0)
                if share < 1e-9 and even:
                    continue
                if even:
                    angle = (min(angle + turn / 2, cut.leave) + max(angle - turn / 2, cut.entry)) / 2
                s, c = np.sin(angle), np.cos(angle)
                before = (tooth - 1) % cut.teeth
                there = place - part + off(before, i)[1]
                if even:
                    left = left_by(before, i, place, travelled)
                else:
                    nodes = int(np.floor(there + 1e-9)) + np.arange(-1, 3)
                    values = [left_by(before, i, n, travelled) for n in np.clip(nodes, low, high)]
                    left = float(BarycentricInterpolator(nodes, values)(there))
                radial = runout[0] * np.cos(lag * turn) - runout[1] * np.sin(lag * turn)
                reach = (middle[0] + travelled) * s + middle[1] * c + radial
                chip = reach - left
                fresh[tooth, i, place] = max(reach, left)
                if chip > 0:
                    width = depth / slices * share
                    tangential, normal = width * (cut.ktc * chip + kte), width * (cut.krc * chip + kre)
                    now += [-tangential * c - normal * s, tangential * s - normal * c]
        surface.update(fresh)
        displacements.append(sum(p * q[0] for p, q in zip(shape, motion, strict=True)))
        forces.append(now)
        motion = [(e @ np.array([*q, p @ now]))[:2] for p, e, q in zip(shape, full, motion, strict=True)]
        force = now
    return np.array(displacements).T, np.array(forces).T
