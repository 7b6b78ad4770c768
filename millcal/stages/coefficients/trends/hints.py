"""Why residuals exceed the noise: what the model would need to explain them, tried on the first revolutions."""

import numpy as np

from millcal.stages.coefficients.trends import judge
from millcal.stages.coefficients.trends.problem import LAWS, CutRecord, Noise, cut_record
from millcal.stages.coefficients.trends.start import Start, find_start

CANDIDATES = 0.05 * 2.0 ** np.arange(2, -3, -1)  # of the sample rate: corners of a low-pass that may have been left out
FORGOTTEN = 0.5  # a model that leaves less than this share of chi2's excess over 1 explains much


def beyond_noise(start: Start, noise: Noise) -> float:
    """Mean square of the start's residuals over that of the noise, without what other levels in each revolution explain.

    Wear and a chipped edge change levels within the first revolutions already, and are no fault of the law.
    """
    part = start.record.of(start.samples)
    D, seen = part.directions, part.settled(part.memory)
    r = start.residual[seen] / noise.sd
    columns = part.response(start.parameters)[1][seen][:, :, 0 : 2 * D : 2] / noise.sd[:, np.newaxis]
    turn = np.unique(np.stack([part.cut, part.passage.angle // (2 * np.pi)])[:, seen], axis=1, return_inverse=True)[1]
    turns = int(turn.max(initial=-1)) + 1
    normal, along = np.zeros((turns, D, D)), np.zeros((turns, D))
    np.add.at(normal, turn, np.einsum("sap,saq->spq", columns, columns))
    np.add.at(along, turn, np.einsum("sap,sa->sp", columns, r))
    size = np.maximum(np.trace(normal, axis1=1, axis2=2), 1e-300)[:, np.newaxis, np.newaxis]
    level = np.linalg.solve(normal + 1e-9 * size * np.eye(D), along[:, :, np.newaxis])[:, :, 0]
    r = r - np.einsum("sap,sp->sa", columns, level[turn])
    return float(np.sum(r**2)) / max(r.size - len(start.parameters) - turns * D, 1)


def find_hints(
    record: CutRecord,
    start: Start,
    noise: Noise,
    beyond: float,
    *,
    runout: bool,
    lowpass: float | None,
    smoothing: float | None,
) -> list[str]:
    """What would explain residuals that exceed the noise: a low-pass, a runout or a law that the model does not have."""
    if beyond <= judge.REFUSE or noise.source == "residual":
        return []
    hints = []

    def explains(chi2: float) -> bool:
        return chi2 - 1 < FORGOTTEN * (beyond - 1)

    def otherwise(law: str, corner: float | None) -> float:
        other = cut_record(
            record.cuts, law=law, lowpass=corner, lowpass_order=2, smoothing=smoothing, nodes=record.nodes
        )
        return beyond_noise(find_start(other, noise.sd, runout=False, known=start.runout), noise)

    said = f"chi2 of the first revolutions from {beyond:.3g}"
    if not runout and record.cutter.teeth > 1:
        with_runout = beyond_noise(find_start(record, noise.sd, runout=True, known=(0.0, 0.0)), noise)
        if explains(with_runout):
            hints.append(f'runout brings {said} to {with_runout:.3g}: set runout = "fit"')
    law = next(other for other in LAWS if other != record.law)
    if lowpass is None:
        tried = [(otherwise(record.law, corner), corner) for corner in CANDIDATES * record.cuts[0].sample_rate]
        for step in (2**0.5, 2**0.25):
            near = min(tried)[1]
            tried += [(otherwise(record.law, corner), corner) for corner in (near / step, near * step)]
        chi2, corner = min(tried)
        if explains(chi2):
            hints.append(
                f"a low-pass of about {corner:.0f} Hz, order 2, in the force chain brings {said} to {chi2:.3g}: look up that "
                "of the amplifier and state chain_lowpass_hz"
            )
        other = otherwise(law, None)
    else:
        other = otherwise(law, lowpass)
    if explains(other):
        hints.append(f'the {law} law brings {said} to {other:.3g}: set law = "{law}"')
    return hints
