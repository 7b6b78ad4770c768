"""Where a result comes from: versions, the whole recipe, the seed and the sha256 of every input. No clock.

An input may itself be a result, so the chain closes: the sha256 of `coefficients.h5` in a stability map leads to the
recordings named in the provenance of `coefficients.h5`.
"""

import hashlib
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from millcal import __version__
from millcal.errors import RecordingError

PACKAGES = ("numpy", "scipy", "h5py")  # whose version may change a digit or a byte of a result


def sha256_of(path: Path) -> str:
    """Hexadecimal sha256 of a file's bytes, read in pieces."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as problem:
        raise RecordingError(f"{path}: {(problem.strerror or str(problem)).lower()}; check the path") from None


def provenance(inputs: Iterable[Path], recipe_text: str = "", seed: int = 0) -> dict:
    """Provenance of a result made from these files: equal inputs on an equal machine give an equal dict."""
    return {
        "versions": {
            "millcal": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in PACKAGES},
        },
        "seed": seed,
        "inputs": {Path(path).as_posix(): sha256_of(path) for path in inputs},
        "recipe": recipe_text,
    }
