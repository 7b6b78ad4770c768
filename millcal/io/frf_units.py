"""Units of an FRF as files write them: what form a unit belongs to, and its factor to SI.

`g/N`, `(m/s^2)/N`, `m/(N s)`, `1/kg`, `um/kN`: a motion over a force. A force over a force, or a plain 1, is a
transmissibility.
"""

import re

from millcal.errors import RecordingError
from millcal.units import FILE_UNITS, normal_unit

SI_UNITS = {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s^2/N", "transmissibility": "1"}
FORM_OF = {
    "displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance", "force": "transmissibility",
}  # fmt: skip
QUANTITY_OF = {form: quantity for quantity, form in FORM_OF.items()}
FORMS = tuple(SI_UNITS)
WORDS = {  # what an axis may be called
    "receptance": "receptance", "compliance": "receptance", "flexibility": "receptance", "admittance": "receptance",
    "displacement": "receptance", "mobility": "mobility", "velocity": "mobility", "accelerance": "accelerance",
    "inertance": "accelerance", "acceleration": "accelerance", "transmissibility": "transmissibility",
}  # fmt: skip
_OVER_BOTH = re.compile(r"(?P<motion>[^/()]+)/\((?P<force>k?N|lbf)[ .*·]*s(?:\^?(?P<power>2)|²)?\)")
_WHOLE = {"1/kg": ("accelerance", 1.0), "s/kg": ("mobility", 1.0), "s^2/kg": ("receptance", 1.0)}
_WHOLE |= {"1": ("transmissibility", 1.0), "-": ("transmissibility", 1.0), "%": ("transmissibility", 0.01)}


def frf_unit(text: str) -> tuple[str, float] | None:
    """The form that a unit belongs to and its factor to SI, None where it is no unit of an FRF.

    >>> frf_unit("g/N"), frf_unit("mm/N"), frf_unit("m/(N s^2)"), frf_unit("V/N")
    (('accelerance', 9.80665), ('receptance', 0.001), ('accelerance', 1.0), None)
    """
    bare = text.strip().strip("[]").strip()
    if bare in _WHOLE:
        return _WHOLE[bare]
    bare = (
        bare.replace("N^-1", "/N").replace("N⁻¹", "/N").replace("s^-2", "/s^2").replace("s^-1", "/s").replace(" /", "/")
    )
    both = _OVER_BOTH.fullmatch(bare)
    if both:
        power = "^2" if both["power"] or "²" in bare else ""
        bare = f"{both['motion']}/s{power}/{both['force']}"
    motion, slash, force = bare.rpartition("/")
    if not slash:
        return None
    above, below = (FILE_UNITS.get(normal_unit(part.strip().strip("()"))) for part in (motion, force))
    if above is None or below is None or below[0] != "force" or above[0] not in FORM_OF:
        return None
    return FORM_OF[above[0]], above[2] / below[2]


def form_of_words(text: str) -> str | None:
    """The form that an axis label tells: `Inertance (mag)` -> accelerance; None where it tells none or several."""
    found = {form for word, form in WORDS.items() if word in text.lower()}
    return found.pop() if len(found) == 1 else None


def stated_unit(form: str | None, unit: str | None) -> tuple[str | None, float | None]:
    """Form and factor to SI as a user states them; None where not stated.

    raises RecordingError for an unknown form or unit, and where the two contradict each other
    """
    if form is not None and form not in FORMS:
        raise RecordingError(f"form {form}: not known; use one of {', '.join(FORMS)}")
    if unit is None:
        return form, None
    known = frf_unit(unit)
    if known is None:
        raise RecordingError(f"--unit {unit}: no unit of an FRF; write g/N, m/s^2/N, m/N or the like")
    if form not in (None, known[0]):
        raise RecordingError(f"--unit {unit}: the unit of {known[0]}, not of {form}; state one of them")
    return known
