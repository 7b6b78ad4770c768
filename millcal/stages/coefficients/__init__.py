"""Cutting coefficients from conditioned dynamometer cuts, with intervals, checks and a verdict.

`average` is the regression of mean forces that everybody knows; `nls` fits the force within the revolution, finds runout
and phase, predicts cuts it has not seen, and says whether its law holds. What the two share, and the shape of the answer,
stands here; the methods are functions in a dict.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from millcal.data import Coefficients, CutForce, Frf, Notice
from millcal.errors import IllPosedError, RecipeError
from millcal.stages.coefficients.instantaneous import LAW_NAMES, instantaneous
from millcal.stages.coefficients.mean_force import average_force


def fit_coefficients(
    cuts: Sequence[CutForce],
    *,
    method: str = "nls",
    law: str = "linear-edge",
    rows: str = "whole-revolutions",
    taper: bool = False,
    harmonics: int | None = None,
    contact_loss: str = "report",
    mean_weight: float = 5.0,
    sensor: Frf | None = None,
) -> Coefficients:
    """Coefficients of a force law from cuts of one cutter.

    method : average or nls   law : linear-edge or kienzle (nls only)
    rows : whole-revolutions, or all rows of the steady part (average only, to compare with others' numbers)
    taper : let the runout vary along the axis (nls)   harmonics : highest harmonic used (nls; default: the tooth passing,
        or with a sensor all that its FRF covers)
    contact_loss : report (look for it and say so), fit (the runout c0 is an unknown like the others), off (average)
    mean_weight : weight of the mean forces against the harmonics (nls); 1 where offsets are suspect
    sensor : measured transmissibility of the dynamometer, N/N (nls)

    Raises
    ------
    RecipeError
        An option is unknown or does not go with the method.
    IllPosedError
        The cuts cannot determine the coefficients.
    """
    if method not in METHODS:
        raise RecipeError(f"coefficients.method: {method!r} is unknown; choose one of {', '.join(METHODS)}")
    if law not in LAW_NAMES:
        raise RecipeError(f"coefficients.law: {law!r} is unknown; choose one of {', '.join(LAW_NAMES)}")
    if not cuts:
        raise IllPosedError("cuts: there are none; name at least one recording of a cut")
    if any(cut.cutter != cuts[0].cutter for cut in cuts):
        raise IllPosedError("cuts: they were made with different cutters; identify each cutter by itself")
    own = {
        "average": {"rows": rows, "contact_loss": contact_loss},
        "nls": {"taper": taper, "harmonics": harmonics, "mean_weight": mean_weight},
    }
    for other, options in own.items():
        for name, value in options.items():
            if other != method and value != fit_coefficients.__kwdefaults__[name]:
                raise RecipeError(
                    f"coefficients.{name}: {value!r} goes with method {other}, not {method}; leave it out"
                )
    if method == "nls":
        own["nls"]["sensor"] = sensor
    found = METHODS[method](tuple(cuts), law=law, **own[method])
    if sensor is not None and method == "average":
        message = "mean forces are forces at rest, where a dynamometer's gain is 1: the sensor's FRF is not used"
        found = replace(found, notices=(*found.notices, Notice("sensor-unused", message, "coefficients.method")))
    return found


METHODS: dict[str, Callable[..., Coefficients]] = {"average": average_force, "nls": instantaneous}
