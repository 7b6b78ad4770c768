"""The report of a result folder: one self-contained HTML page from the records, the summary and the provenance.

Everything drawn comes from the records; this room scales, thins and words it, and computes nothing that a stage did not
save. Any record may be missing: its sections are then left out.
"""

from collections.abc import Mapping
from typing import Any


def render(results: Mapping[str, Any], summary: Mapping[str, Any], provenance: Mapping[str, Any]) -> str:
    """The report as HTML text; the same input gives the same bytes.

    results : any of "cuts" (sequence of CutForce), "frf" (Frf), "modes" (Modes), "coefficients" (Coefficients),
        "stability" (StabilityMap); a missing or None entry leaves its sections out
    summary : what `summary.json` holds; read are `title`, `warnings` [{code, message, where}],
        `expect` [{key, value, interval, ok}] and `recordings` [{name, path, kind, sample_rate_hz, duration_s,
        channels: [{name, quantity, unit, dof}]}], each optional
    provenance : `versions` {name: version}, `inputs` {path: sha256}, `seed`, `recipe` (its whole text), each optional
    """
    raise NotImplementedError
