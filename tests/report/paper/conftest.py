"""Figures of sample records, laid out as they will be written, and of the records that are hardest to draw."""

import re
from dataclasses import replace

import numpy as np
import pytest
import stability_maps
from histories import two_cuts, unknown, wide, worn
from modal_fits import cut_off, single, six_by_three
from reconstructed_forces import MAKERS, coefficients_of

from millcal.data import Posterior, StabilityMap
from millcal.report.paper import figures_of, sheet

WANTED = {  # figures of a hard case that are like none before
    "seven cuts, two alike": "force-revolution-[1367]|mean",
    "a record cut off": "modal-fit",
    "another law": "coefficients",
    "no other model": "coefficients",
}


def with_cuts(fit, n: int):
    """The same fit with n cuts, taken in turn from those it has: some then have the same conditions."""
    turn = np.arange(n) % len(fit.cuts)
    arrays = ("feed_per_tooth", "measured_mean", "modelled_mean", "measured", "modelled")
    amplitudes = ("measured_amplitude", "modelled_amplitude", "left_out_by_cut", "phase")
    return replace(
        fit,
        cuts=tuple(f"{number}-{fit.cuts[k].rpartition('/')[2]}" for number, k in enumerate(turn)),
        conditions=tuple(fit.conditions[k] for k in turn),
        **{name: getattr(fit, name)[turn] for name in (*arrays, *amplitudes)},
    )


def kienzle(fit):
    """The same fit with the names of the other law, and with models that know other parameters."""
    names = ("kt", "kr", "ka", "mt", "mr", "ma")
    mean = np.array([7e8, 2e8, 4e7, 0.2, 0.3, 0.4])
    half = 0.1 * mean
    interval = np.stack([mean - half, mean + half], axis=1)
    units = ("N/m^2",) * 3 + ("1",) * 3
    posterior = Posterior(
        names=names,
        units=units,
        mean=mean,
        covariance=np.diag(half**2),
        interval=interval,
        law="kienzle",
        method="nls",
    )
    return replace(fit, posterior=posterior, alternatives=(*fit.alternatives, ("harmonics to 30", (("kt", 7.2e8),))))


@pytest.fixture(scope="session")
def stability(stability) -> StabilityMap:
    """The map with its best speeds at tops of pockets, as the stage finds them."""
    limit = stability.limit_depth
    tops = np.flatnonzero((limit[1:-1] > limit[:-2]) & (limit[1:-1] >= limit[2:]) & np.isfinite(limit[1:-1])) + 1
    tops = tops[np.argsort(-limit[tops])][: len(stability.best)]
    pairs = zip(stability.best, tops, strict=True)
    best = [replace(b, spindle_speed=stability.spindle_speed[top], axial_depth=limit[top]) for b, top in pairs]
    return replace(stability, best=tuple(best))


@pytest.fixture(scope="session")
def results(cuts, coefficients, frf, stability) -> dict:
    return {"cuts": cuts, "coefficients": coefficients, "frf": frf, "modes": six_by_three(), "stability": stability}


@pytest.fixture(scope="session")
def hard_results(coefficients, frf, stability) -> dict[str, dict]:
    one = replace(
        frf,
        values=frf.values[:, :1, :1],
        coherence=None,
        multiple_coherence=None,
        variance=None,
        force_spectrum=None,
        outputs=("tipX",),
        inputs=("+tipX",),
        hits_used=(1,),
    )
    crossed = replace(one, form="transmissibility", outputs=("Fx",), variance=frf.variance[:, :1, :1])
    rigid = replace(
        stability,
        limit_depth=np.where(stability.spindle_speed > 1000, np.inf, stability.limit_depth),
        limit_low=None,
        limit_high=None,
        best=(),
        operating=None,
    )
    no_limit = replace(rigid, limit_depth=np.full_like(rigid.limit_depth, np.inf), absolute_minimum=np.inf)
    return {
        "one direction, one hit": {"frf": one},
        "one FRF without hits": {"modes": single()},
        "a record cut off": {"modes": cut_off()},
        "no driving point": {"frf": crossed},
        "without a limit at high speed": {"stability": rigid},
        "without any limit": {"stability": no_limit},
        **{f"a map, {name}": {"stability": maker()} for name, maker in stability_maps.MAKERS.items()},
        "methods compared": {"stability_compared": stability_maps.compared()},
        "one cut": {"coefficients": with_cuts(coefficients, 1)},
        "seven cuts, two alike": {"coefficients": with_cuts(coefficients, 7)},
        "another law": {"coefficients": kienzle(coefficients)},
        "a jump": {"coefficients": worn()},
        "two cuts, three directions": {"coefficients": two_cuts()},
        "bands of a prior": {"coefficients": wide()},
        "nothing but values": {"coefficients": unknown()},
        "no other model": {"coefficients": replace(coefficients, alternatives=())},
        "coefficients of accelerations": {"coefficients": coefficients_of(MAKERS["a slot"]())},
        **{f"accelerations, {name}": {"forces": maker()} for name, maker in MAKERS.items()},
    }


@pytest.fixture(scope="session")
def figures(results, hard_results) -> dict:
    """All of them by a name; laid out once, since that takes its time."""
    with sheet.style():
        drawn = dict(figures_of(results))
        for case, records in hard_results.items():
            wanted = re.compile(WANTED.get(case, ".*"))
            drawn |= {f"{case}: {name}": figure for name, figure in figures_of(records).items() if wanted.match(name)}
        for figure in drawn.values():
            figure.draw_without_rendering()
    return drawn
