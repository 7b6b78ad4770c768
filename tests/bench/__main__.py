"""Measure millcal beside plain code and write docs/benchmarks.md: `make bench`.

A section is a function of the options that returns its Markdown; a line in SECTIONS puts it on the page.
"""

import argparse
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

from convergence import convergence
from floquet import floquet
from followed_cut import followed_cut
from force import force
from forces import forces
from impact import impact
from main_job import main_job
from smoother import smoother
from stability import stability
from stability_draws import stability_draws
from start import start
from text_reader import text_reader
from time_domain import time_domain
from trends import trends

SECTIONS = {
    "Text reader": text_reader,
    "Start": start,
    "Force and coefficients": force,
    "Impact tests": impact,
    "Stability map": stability,
    "Floquet": floquet,
    "Convergence": convergence,
    "Stability of many draws": stability_draws,
    "Time domain": time_domain,
    "Trends": trends,
    "Smoother": smoother,
    "A minute of a cut": followed_cut,
    "Forces from accelerations": forces,
    "Main job": main_job,
}

PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"


def machine() -> str:
    """Processor, memory and versions, in one line each."""
    described = Path("/proc/cpuinfo").read_text().splitlines()
    processor = next(
        (line.split(":")[1].strip() for line in described if line.startswith("model name")), platform.machine()
    )
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    packages = ", ".join(f"{name} {version(name)}" for name in ("millcal", "numpy", "scipy", "pandas", "h5py", "numba"))
    return (
        f"Machine: {os.cpu_count()} cores of {processor}, {memory:.0f} GB, {platform.system()} {platform.release()}.\n"
        f"Python {platform.python_version()}, {packages}. Load before the run: {os.getloadavg()[0]:.1f}."
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python tests/bench", description=__doc__.splitlines()[0])
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"print these alone: {', '.join(SECTIONS)}")
    parser.add_argument("--size-mb", type=int, default=200, help="size of the text file that is read (default 200)")
    parser.add_argument("--full", dest="size_mb", action="store_const", const=1000, help="the same as --size-mb 1000")
    parser.add_argument("--repeats", type=int, default=5, help="how often each command is run (default 5)")
    options = parser.parse_args()
    unknown = set(options.sections) - set(SECTIONS)
    if unknown:
        parser.error(f"no section {', '.join(sorted(unknown))}; there are: {', '.join(SECTIONS)}")

    os.chdir(PAGE.parents[1])
    parts = []
    for title in options.sections or SECTIONS:
        print(f"measuring: {title}", file=sys.stderr)
        parts.append(f"## {title}\n\n{SECTIONS[title].__doc__.strip()}\n\n{SECTIONS[title](options)}\n")
    if options.sections:
        print("\n".join(parts))
        return
    command = f"make bench ARGS='--size-mb {options.size_mb} --repeats {options.repeats}'"
    head = f"# What millcal costs, measured\n\n{machine()}\n\nMade by `{command}`; commands compared take turns.\n"
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text("\n".join([head, *parts]))
    print(PAGE)


main()
