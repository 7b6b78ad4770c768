"""Units at the border: the suffix of a key is its unit, and everything inside is SI.

`from_shop(6000.0, "spindle_speed_rpm")` is 628.3 rad/s; the longest matching suffix wins. Units written in files ("kN",
"g", "µm") are looked up in `FILE_UNITS`, which also tells the physical quantity.
"""

from functools import lru_cache
from math import pi

# suffix of a key -> factor to SI
SUFFIXES = {
    "rpm": 2 * pi / 60,
    "mm_per_min": 1e-3 / 60,
    "N_per_mm2": 1e6,
    "N_per_mm": 1e3,
    "N_per_m": 1.0,
    "cm3_per_min": 1e-6 / 60,
    "m_per_N": 1.0,
    "um_per_N": 1e-6,
    "Ns_per_m": 1.0,
    "per_s": 1.0,
    "mm": 1e-3,
    "um": 1e-6,
    "deg": pi / 180,
    "hz": 1.0,
    "kg": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "s": 1.0,
    "m": 1.0,
    "N": 1.0,
    "g": 9.80665,
}

# unit as written in a file -> (quantity, SI unit, factor to SI)
FILE_UNITS = {
    "N": ("force", "N", 1.0),
    "kN": ("force", "N", 1e3),
    "mN": ("force", "N", 1e-3),
    "lbf": ("force", "N", 4.4482216152605),
    "lb": ("force", "N", 4.4482216152605),
    "pounds": ("force", "N", 4.4482216152605),
    "m/s^2": ("acceleration", "m/s^2", 1.0),
    "mm/s^2": ("acceleration", "m/s^2", 1e-3),
    "g": ("acceleration", "m/s^2", 9.80665),
    "m/s": ("velocity", "m/s", 1.0),
    "mm/s": ("velocity", "m/s", 1e-3),
    "m": ("displacement", "m", 1.0),
    "mm": ("displacement", "m", 1e-3),
    "um": ("displacement", "m", 1e-6),
    "rad": ("angle", "rad", 1.0),
    "deg": ("angle", "rad", pi / 180),
    "V": ("voltage", "V", 1.0),
    "mV": ("voltage", "V", 1e-3),
    "Pa": ("sound_pressure", "Pa", 1.0),
    "FS": ("sound", "FS", 1.0),  # full scale of a recorder that says nothing of pascals
    "1": ("pulse", "1", 1.0),
}

_SPELLINGS = {
    "µm": "um", "μm": "um", "micron": "um", "microns": "um", "newton": "N", "newtons": "N", "n": "N", "kn": "kN",
    "m/s²": "m/s^2", "m/s2": "m/s^2", "m/s**2": "m/s^2", "m/s/s": "m/s^2", "mm/s²": "mm/s^2", "mm/s2": "mm/s^2",
    "G": "g", "gn": "g", "grms": "g", "°": "deg", "degree": "deg", "degrees": "deg", "pound": "lbf", "lbs": "lbf",
    "volt": "V", "volts": "V", "v": "V", "mv": "mV", "pa": "Pa",
}  # fmt: skip


def normal_unit(text: str) -> str:
    """The unit's one spelling here: `m/s²` and `m/s2` are `m/s^2`, `µm` is `um`; an unknown one comes back stripped."""
    unit = text.strip().strip("[]()").strip()
    if unit in FILE_UNITS:
        return unit
    return (
        _SPELLINGS.get(unit) or _SPELLINGS.get(unit.lower()) or (unit.lower() if unit.lower() in FILE_UNITS else unit)
    )


@lru_cache(maxsize=4096)
def suffix_of(key: str) -> str | None:
    """The unit suffix of a key, longest first, or None: `feed_per_tooth_mm` -> `mm`."""
    matching = [suffix for suffix in SUFFIXES if key.endswith("_" + suffix)]
    return max(matching, key=len, default=None)


def from_shop(value, key: str):
    """A value with the unit of the key's suffix, in SI.

    >>> round(from_shop(6000.0, "spindle_speed_rpm"), 4)
    628.3185
    """
    suffix = suffix_of(key)
    return value if suffix is None else value * SUFFIXES[suffix]


def to_shop(value, key: str):
    """An SI value in the unit of the key's suffix; the inverse of `from_shop`."""
    suffix = suffix_of(key)
    return value if suffix is None else value / SUFFIXES[suffix]
