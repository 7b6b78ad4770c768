"""Every method by its name: those that fit one set of coefficients, those that follow coefficients through the cut, and
those that have them from forces reconstructed from accelerations.

The first see cuts averaged over revolutions (`CutForce`), the second the samples themselves (`CutSamples`), the last the
harmonics of accelerations (`CutVibration`) by way of the stage `forces`; `follows` and `hears` say which a method wants. An
option is refused where it does not belong: who names it expects something of it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from millcal.data import CoefficientHistory, Coefficients, CutForce, CutSamples, Frf
from millcal.errors import RecipeError
from millcal.stages.coefficients import LAW_NAMES, fit_coefficients

FITTING = {
    "nls": ("taper", "harmonics", "mean_weight"),
    "average": ("rows", "contact_loss"),
}
_ALL_FOLLOWING = ("runout", "chain_lowpass", "chain_lowpass_order", "smoothing", "bounds", "chip_threshold", "nodes")
FOLLOWING = {
    "smooth": (*_ALL_FOLLOWING, "jumps"),
    "imm": (*_ALL_FOLLOWING, "jumps"),
    "rls": (*_ALL_FOLLOWING, "forgetting"),
    "enkf": (*_ALL_FOLLOWING, "members"),
    "enkf-inflated": (*_ALL_FOLLOWING, "members", "inflate_every", "inflated_share", "inflation"),
}  # method -> its options beside the law
FROM_ACCELERATIONS: dict[str, tuple[str, ...]] = {"gtls": ()}  # their options are those of the stage `forces`
KEYS = {
    "chain_lowpass": "chain_lowpass_hz",
    "smoothing": "lowpass_hz",
    "chip_threshold": "chip_threshold_um",
}  # as a recipe writes them


def follows(method: str) -> bool:
    """Whether a method follows coefficients through the samples of a cut."""
    return method in FOLLOWING


def hears(method: str) -> bool:
    """Whether a method has the coefficients from accelerations and an FRF."""
    return method in FROM_ACCELERATIONS


def identify_coefficients(
    cuts: Sequence[CutForce] | Sequence[CutSamples],
    *,
    method: str = "nls",
    law: str = "linear-edge",
    rows: str = "whole-revolutions",
    taper: bool = False,
    harmonics: int | None = None,
    contact_loss: str = "report",
    mean_weight: float = 5.0,
    runout: str = "fit",
    chain_lowpass: float | None = None,
    chain_lowpass_order: int = 2,
    smoothing: float | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    chip_threshold: float = 0.5e-6,
    jumps: bool = True,
    forgetting: float = 0.98,
    members: int = 100,
    inflate_every: int = 50,
    inflated_share: float = 0.1,
    inflation: float = 10.0,
    nodes: int = 8,
    sensor: Frf | None = None,
    rng: np.random.Generator,
    progress: Callable[[float, str], None] | None = None,
) -> Coefficients | CoefficientHistory:
    """Coefficients of a force law from cuts of one cutter, by any method.

    cuts : conditioned; for a method that `follows`, their samples
    method, law : nls, average, smooth, imm, rls, enkf or enkf-inflated; linear-edge or kienzle
    rows, contact_loss : whole-revolutions or all; report, fit or off   taper, harmonics, mean_weight, sensor : as these of
        `fit_coefficients`
    runout, smoothing, bounds, chip_threshold, jumps, forgetting, members, inflate_every, inflated_share, inflation, nodes : as of
        `follow_coefficients`; runout is fit or known   chain_lowpass, chain_lowpass_order : its low-pass, Hz

    Raises
    ------
    RecipeError
        An option is unknown, out of range, or does not go with the method.
    IllPosedError
        The cuts cannot determine the coefficients.
    """
    own = own_options(
        method,
        law=law,
        sensor=sensor is not None,
        rows=rows,
        taper=taper,
        harmonics=harmonics,
        contact_loss=contact_loss,
        mean_weight=mean_weight,
        runout=runout,
        chain_lowpass=chain_lowpass,
        chain_lowpass_order=chain_lowpass_order,
        smoothing=smoothing,
        bounds=bounds,
        chip_threshold=chip_threshold,
        jumps=jumps,
        forgetting=forgetting,
        members=members,
        inflate_every=inflate_every,
        inflated_share=inflated_share,
        inflation=inflation,
        nodes=nodes,
    )
    if not follows(method):
        return fit_coefficients(cuts, method=method, law=law, sensor=sensor, **own)  # type: ignore[arg-type]
    from millcal.stages.coefficients.trends import follow_coefficients  # brings numba

    own["lowpass"], own["lowpass_order"] = own.pop("chain_lowpass"), own.pop("chain_lowpass_order")
    return follow_coefficients(cuts, method=method, law=law, rng=rng, progress=progress, **own)  # type: ignore[arg-type]


def own_options(method: str, *, law: str, sensor: bool = False, **options: Any) -> dict[str, Any]:
    """Those of the given options that the method takes; the others must be as they are by default.

    sensor : whether an FRF of the dynamometer is given

    Raises
    ------
    RecipeError
        The method or the law is unknown, or an option does not go with the method.
    """
    methods = {**FITTING, **FOLLOWING, **FROM_ACCELERATIONS}
    for name, value, known in (("method", method, methods), ("law", law, LAW_NAMES)):
        if value not in known:
            raise RecipeError(f"coefficients.{name}: {value!r} is unknown; choose one of {', '.join(known)}")
    own = methods[method]
    for name, value in options.items():
        if name not in own and value != identify_coefficients.__kwdefaults__[name]:
            takers = [other for other, taken in methods.items() if name in taken]
            raise RecipeError(
                f"coefficients.{KEYS.get(name, name)}: goes with method {_either(takers)}, not {method}; leave it out"
            )
    if hears(method) and law != "linear-edge":
        raise RecipeError(
            f"coefficients.law: {law!r} is not linear, and accelerations tell coefficients of the linear-edge law alone; "
            f"leave it out, or use another method than {method}"
        )
    if sensor and hears(method):
        raise RecipeError(
            f"coefficients.sensor: an FRF of a dynamometer has no place in method {method}, which needs none; leave it out"
        )
    if sensor and follows(method):
        raise RecipeError(
            f"coefficients.sensor: method {method} has no place for an FRF of the dynamometer; give the low-pass of its "
            "amplifier as chain_lowpass_hz, or use method nls"
        )
    return {name: options[name] for name in own if name in options}


def _either(names: Sequence[str]) -> str:
    """`a`, `a or b`, `a, b or c`"""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
