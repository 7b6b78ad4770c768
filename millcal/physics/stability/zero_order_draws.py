"""Zero-order limits of many structures and forces at once, compiled: for bands, maps of probability, learners."""

from collections.abc import Callable, Sequence

import numpy as np

from millcal.physics.stability.regeneration import TipModes
from millcal.physics.stability.zero_order import resonance_grid, search_range


def limits_of_one_mode(
    spindle_speed: np.ndarray,
    natural_frequency: np.ndarray,
    damping_ratio: np.ndarray,
    stiffness: np.ndarray,
    cutting: np.ndarray,
    teeth: int,
) -> np.ndarray:
    """`zero_order.limit_of_one_mode` for many modes and forces, compiled; inf where nothing chatters.

    spindle_speed : (speed,) rad/s   natural_frequency, damping_ratio, stiffness : (draw,) Hz, 1, N/m
    cutting : A = u^T Q u along the mode's direction u, (draw,) N/m^2   returns (draw, speed) m
    """
    from millcal.physics.stability.zero_order_kernel import one_mode_depths

    columns = (2 * np.pi * np.asarray(natural_frequency, float), damping_ratio, stiffness, cutting)
    turns, damping, stiffness, cutting = (
        np.ascontiguousarray(column, float) for column in np.broadcast_arrays(*map(np.atleast_1d, columns))
    )
    depth = np.empty((len(turns), len(spindle_speed)))
    one_mode_depths(turns, damping, stiffness, cutting, float(teeth), np.asarray(spindle_speed, float), depth)
    return depth


def limits_of_draws(
    spindle_speed: np.ndarray,
    tips: Sequence[TipModes],
    cutting: np.ndarray,
    teeth: int,
    *,
    remainder: np.ndarray | None = None,
    remainder_power: Sequence[int] = (),
    band: tuple[float, float] | None = None,
    progress: Callable[[float], None] | None = None,
) -> np.ndarray:
    """The limit of many structures and forces at many speeds, compiled: for bands, maps of probability, learners.

    spindle_speed : (speed,) rad/s   tips : one for each draw, or one for all   cutting : Q, (draw, 2, 2) or (2, 2) N/m^2
    remainder, remainder_power : what stands for other modes, beside the tips' own flexibility (`structure.modal_receptance`)
    band : Hz, where chatter is looked for (default: `zero_order.search_range`)   returns (draw, speed) m, inf where there is none
    """
    speeds = np.ascontiguousarray(spindle_speed, float)
    cutting = np.asarray(cutting, float).reshape(-1, 2, 2)
    draws = max(len(tips), len(cutting))
    cutting = np.broadcast_to(cutting, (draws, 2, 2))
    alone = single_modes(tips) if remainder is None and band is None else None
    if alone is not None:
        natural, damping, stiffness, direction = alone
        along = np.einsum(
            "ni,nij,nj->n", np.broadcast_to(direction, (draws, 2)), cutting, np.broadcast_to(direction, (draws, 2))
        )
        return limits_of_one_mode(speeds, natural, damping, stiffness, along, teeth)

    from millcal.physics.stability.zero_order_kernel import any_modes_depths

    depth = np.empty((draws, len(speeds)))
    for i in range(draws):
        if i == 0 or len(tips) > 1:
            tip = tips[i]
            natural, damping = np.abs(tip.pole) / (2 * np.pi), -tip.pole.real / np.abs(tip.pole)
            grid = resonance_grid(natural, damping, band or search_range(natural, speeds, teeth), per_mode=121)
            residue = tip.output[:, :, np.newaxis] * tip.given[:, np.newaxis, :]
            terms = [np.zeros((0, 2, 2)) if remainder is None else np.asarray(remainder), tip.flexibility[np.newaxis]]
            powers = np.array([*remainder_power, 0], np.int64)
        any_modes_depths(
            grid, tip.pole, residue, np.concatenate(terms).astype(complex), powers, cutting[i], float(teeth), speeds, depth[i]
        )  # fmt: skip
        if progress is not None and i % 16 == 0:
            progress(i / draws)
    return depth


def single_modes(tips: Sequence[TipModes]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Natural frequency Hz, damping ratio, stiffness N/m, unit direction (tip, 2), if each tip is one real mode; else None."""
    found = []
    for tip in tips:
        if len(tip.pole) != 1 or np.any(tip.flexibility):
            return None
        residue = np.outer(tip.output[0], tip.given[0]) * 2j * tip.pole[0].imag  # p p^T of a real mode
        size = np.trace(residue).real
        direction = residue[:, np.argmax(np.abs(np.diag(residue)))].real
        direction = direction / (np.linalg.norm(direction) or 1.0)
        if not size > 0 or np.abs(residue - size * np.outer(direction, direction)).max() > 1e-12 * size:
            return None
        w = np.abs(tip.pole[0])
        found.append((w / (2 * np.pi), -tip.pole[0].real / w, w**2 / size, *direction))
    columns = np.array(found)
    return columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 3:]
