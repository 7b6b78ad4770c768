"""Impact tests beside pyFRF, scipy and sdypy-EMA on simulated recordings: what each reaches, costs and holds in memory."""

import os
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
from measure import spread, table

sys.path.append(str(Path(__file__).parents[1] / "generators"))

import impact_peers as peers
from impact_cases import KINDS, Case, make_case
from impact_errors import frf_error, modal_errors

from millcal.data import Frf, Modes
from millcal.stages.frf import estimate_frf
from millcal.stages.modes import corrected_frf, fit_modes

TIMED = "04_B_med"  # 9 hits in 3 directions, 7 channels of 8192 samples: 1.55 million
LOSSY = "10_C_light"  # its H1 needs the correction that the modal fit brings


def ways_to_frf(case: Case):
    """What is compared: name -> function of nothing that returns an FRF, as receptance, or None where it cannot."""
    cuts = peers.cut_hits(case)
    window = peers.force_window(cuts)
    ways = {"scipy csd": lambda: peers.scipy_csd(cuts)}
    if not peers.missing():
        ways = {
            "pyFRF": lambda: peers.pyfrf(cuts),
            "pyFRF, force window": lambda: peers.pyfrf(cuts, window),
            "pyFRF, expert": lambda: peers.pyfrf(cuts, window, expert=True),
            **ways,
        }
    return ways


def h1_error(case: Case, frf: Frf) -> float:
    return frf_error(case.structure, frf.frequency, frf.values, frf.form, frf.outputs, frf.inputs)


def judged(case: Case, modes: Modes):
    """ModalErrors of our fit and the error of its FRF."""
    fit = modes.fit
    found = modal_errors(
        case.structure, modes.natural_frequency, modes.damping_ratio, fit.residue, fit.outputs, fit.inputs
    )
    return found, frf_error(case.structure, fit.frequency, fit.synthesised, fit.form, fit.outputs, fit.inputs)


def as_receptance(frf: Frf) -> peers.Estimate:
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[frf.form]
    with np.errstate(divide="ignore", invalid="ignore"):
        return peers.Estimate(frf.frequency, frf.values / ((2j * np.pi * frf.frequency) ** power)[:, None, None])


def measure(seeds: int):
    """Errors of everybody on every kind: two tables {kind: {way: [of each seed]}} of H1 and of modes."""
    h1: dict[str, dict[str, list]] = {}
    modal: dict[str, dict[str, list]] = {}
    for name in KINDS:
        print(f"  {name}", file=sys.stderr)
        h1[name], modal[name] = {}, {}
        for seed in range(seeds):
            case = make_case(name, seed)
            frf = estimate_frf(case.recordings)
            modes = fit_modes(frf)
            errors = {"millcal": h1_error(case, frf), "millcal, corrected": h1_error(case, corrected_frf(frf, modes))}
            fits = {"millcal, automatic": judged(case, modes)}
            estimates = {way: estimate() for way, estimate in ways_to_frf(case).items()}
            errors |= {way: found.error(case) if found else np.nan for way, found in estimates.items()}
            if not peers.missing():
                for source, estimate in (("pyFRF, expert", estimates["pyFRF, expert"]), ("our H1", as_receptance(frf))):
                    for form in ("accelerance", "receptance"):
                        fits[f"sdypy-EMA, {form}, on {source}"] = peers.ema(case, estimate, form)
            for table_of, found in ((h1[name], errors), (modal[name], fits)):
                for way, value in found.items():
                    table_of.setdefault(way, []).append(value)
    return h1, modal


def h1_table(h1) -> str:
    ways = list(next(iter(h1.values())))
    rows = []
    for name, errors in h1.items():
        ours = np.median(errors["millcal, corrected" if name == LOSSY else "millcal"])
        cells = []
        for way in ways:
            value = np.median(errors[way])
            ratio = "" if way.startswith("millcal") else f" ({value / ours:.2g})"
            cells.append("-" if np.isnan(value) else f"{value:.1e}{ratio}")
        rows.append((name, *cells))
    return table(("kind", *ways), *rows)


def modal_table(modal) -> str:
    ways = list(next(iter(modal.values())))
    rows = []
    for name, fits in modal.items():
        cells = []
        for way in ways:
            found = [[*errors[:3], rebuilt] for errors, rebuilt in filter(None, fits[way])]
            values = np.median(found, axis=0) if found else []
            cells.append(" / ".join(f"{value:.1e}" for value in values) or "-")
        rows.append((name, *cells))
    return table(("kind", *ways), *rows)


def cost_table(repeats: int) -> str:
    """CPU time and the most memory that Python's allocators held, each way alone; the recordings stand in memory before."""
    case = make_case(TIMED, 0)
    frf = estimate_frf(case.recordings)
    receptance = as_receptance(frf)
    ways = {"millcal FRF": lambda: estimate_frf(case.recordings), **ways_to_frf(case)}
    fits = {"millcal modes, automatic": lambda: fit_modes(frf)}
    if not peers.missing():
        fits["sdypy-EMA, frequencies given"] = lambda: peers.ema(case, receptance, "accelerance", orders=(40,))
    million = sum(recording.samples.size for recording in case.recordings) / 1e6
    costs: dict[str, list[float]] = {way: [] for way in (*ways, *fits)}
    for do in (*ways.values(), *fits.values()):
        do()  # imports and caches
    for _ in range(repeats):
        for way, do in (*ways.items(), *fits.items()):
            start = time.process_time()
            do()
            costs[way].append(time.process_time() - start)
    rows = []
    for way, do in (*ways.items(), *fits.items()):
        tracemalloc.start()
        do()
        peak = tracemalloc.get_traced_memory()[1] / 2**20
        tracemalloc.stop()
        per_million = [cost / million for cost in costs[way]]
        rows.append((way, spread(costs[way], ".3f"), spread(per_million, ".3f") if way in ways else "-", f"{peak:.0f}"))
    return table(("way", "CPU s (least / median)", "CPU s per million samples", "peak MB"), *rows)


def page(repeats: int) -> str:
    """The section, measured in this process."""
    h1, modal = measure(repeats)
    parts = [
        f"{repeats} seeds per kind. H1, as receptance: norm of the error over norm of the truth, all channels, in the "
        "band of the modes; in brackets over millcal's, where less than 1.5 says nothing. "
        f"Ratios of {LOSSY} are those to millcal corrected: its records end before the response does.",
        h1_table(h1),
        "Modes: worst of the modes in fn / zeta / residue / the FRF rebuilt from them, relative.",
        modal_table(modal),
        f"Cost, on {TIMED}, one thread:",
        cost_table(repeats),
    ]
    if lack := peers.missing():
        parts.append(f"pyFRF and sdypy-EMA are left out: no {lack} here. To have them: `{peers.INSTALL}`.")
    return "\n\n".join(parts)


def impact(options) -> str:
    """Simulated impact tests with known truth; errors are medians over seeds. Peers get each hit cut out at its true onset
    and the exact natural frequencies; "expert" is told the good hits too, removes the mean before each and windows the
    force to 12.8 ms. millcal finds all of that itself."""
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, __file__, str(options.repeats)]
    return subprocess.run(command, env=os.environ | one_thread, stdout=subprocess.PIPE, text=True, check=True).stdout


if __name__ == "__main__":
    sys.stdout.write(page(int(sys.argv[1]) if len(sys.argv) > 1 else 3))
