"""What the stability map takes of the coefficients: K_tc, K_rc and draws of them, whatever the law they were fitted with.

A regenerative wave is small against the chip, so a curved law counts by its slope. For Kienzle that is the tangent at the
mean chip of the operating feed; the map then holds for that feed. Edge coefficients have no slope.
"""

from dataclasses import replace

import numpy as np

from millcal.data import Notice, Posterior
from millcal.errors import IllPosedError
from millcal.physics.cutting_force import Kienzle, LinearEdge


def cutting_draws(
    posterior: Posterior | tuple[float, float], mean_chip: float, members: int, rng: np.random.Generator | None
) -> tuple[np.ndarray, np.ndarray | None, list[Notice]]:
    """K_tc and K_rc, and draws of them where there is a covariance.   returns (2,), (member, 2) or None, N/m^2"""
    if not isinstance(posterior, Posterior):
        mean, draws, notices = np.array(posterior, float), None, []
    else:
        kienzle = posterior.law == "kienzle"
        names = ("kt", "kr", "mt", "mr") if kienzle else ("Ktc", "Krc")
        missing = [name for name in names if name not in posterior.names]
        if missing:
            raise IllPosedError(
                f"coefficients: {', '.join(missing)} missing; the limit needs {', '.join(names)}: identify them "
                "from cuts that show them"
            )
        if kienzle and not mean_chip > 0:
            raise IllPosedError("stability.feed_per_tooth_mm: a Kienzle law needs the feed of the cut; give it")
        needed = _marginal(posterior, names)
        mean, draws, notices = needed.mean, None, []
        if not np.all(np.isfinite(needed.covariance)):
            notices.append(Notice("no-band", "the coefficients carry no interval, so the limit has no band from them"))
        elif rng is not None and members > 1 and np.any(needed.covariance):
            draws = needed.sample(rng, members)
        if kienzle:
            mean, draws = _tangent(mean, mean_chip), None if draws is None else _tangent(draws, mean_chip)
            notices.append(
                Notice(
                    "kienzle-tangent",
                    f"the limit uses the slope of the Kienzle law at the mean chip of {mean_chip * 1e6:.1f} um, "
                    f"Ktc {mean[0] / 1e6:.0f} and Krc {mean[1] / 1e6:.0f} N/mm2; it holds for that feed",
                )
            )
    if not mean[0] > 0:
        raise IllPosedError(
            f"coefficients.Ktc: {mean[0] / 1e6:.4g} N/mm2 is not positive, so there is no limit to map; "
            "check the signs and the axis map of the cuts"
        )
    if draws is not None and np.any(draws[:, 0] <= 0):
        share = np.mean(draws[:, 0] <= 0)
        draws = draws[draws[:, 0] > 0]
        notices.append(
            Notice("coefficients-vague", f"{share:.1%} of the draws have Ktc below zero and are left out of the band")
        )
    return mean, draws, notices


def edge_force(posterior: Posterior | tuple[float, float]) -> tuple[float, float] | None:
    """K_te and K_re, N/m, if the coefficients have them."""
    if not isinstance(posterior, Posterior) or "Kte" not in posterior.names:
        return None
    return posterior["Kte"], posterior["Kre"] if "Kre" in posterior.names else 0.0


def tangential_law(
    posterior: Posterior | tuple[float, float], edge: tuple[float, float] | None
) -> LinearEdge | Kienzle | None:
    """What turns against the spindle, None where only its slope is known.   edge : K_te, K_re, N/m"""
    if isinstance(posterior, Posterior) and posterior.law == "kienzle":
        force, rise = (np.array([posterior[name], 0.0, 0.0]) for name in ("kt", "mt"))
        return Kienzle(force, rise)
    if edge is None:
        return None
    ktc = posterior["Ktc"] if isinstance(posterior, Posterior) else posterior[0]
    return LinearEdge(np.array([ktc, 0.0, 0.0]), np.array([edge[0], 0.0, 0.0]))


def _marginal(posterior: Posterior, names: tuple[str, ...]) -> Posterior:
    """The posterior of some of its parameters."""
    index = [posterior.names.index(name) for name in names]
    return replace(
        posterior,
        names=names,
        units=tuple(posterior.units[i] for i in index),
        mean=posterior.mean[index],
        covariance=posterior.covariance[np.ix_(index, index)],
        interval=posterior.interval[index],
    )


def _tangent(kienzle: np.ndarray, chip: float) -> np.ndarray:
    """dF/dh per width, k (1 - m) (h/h0)^-m, along t and r.

    kienzle : kt, kr, mt, mr, (..., 4) SI   chip : m   returns (..., 2) N/m^2
    """
    force, rise = kienzle[..., :2], kienzle[..., 2:]
    return force * (1 - rise) * (chip / Kienzle.REFERENCE_CHIP) ** -rise
