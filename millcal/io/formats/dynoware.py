"""The text export of Kistler's DynoWare: `key:,value` lines above an ordinary table.

The binary .dwd file is undocumented and is not read. The header speaks of the whole measurement and the rows may be
a part of it: "Samples per channel" is then not the number of rows, and the time does not start at zero. The date field
may be empty. The delimiter is the one the user chose for the export.
"""

import re
from collections.abc import Sequence

from millcal.data import Notice

_KEY = re.compile(r'"?(?P<key>[^:=;|\t,"]+?)"?\s*(?:[:=]"?\s*[,;|\t]?|[,;|\t])\s*"?(?P<value>[^"]*?)"?[,;|\t ]*')
_RATE = re.compile(
    r"(sampl\w*[ _]?(rate|freq\w*)|sampl\w*|fs|f_s|abtastrate)\b\s*[\[(]?(?P<unit>k?hz|[km]?s/s)?[\])]?", re.I
)
_COUNT = re.compile(r"(samples per channel|number of samples|n samples|samples)", re.I)
_TO_HZ = {"hz": 1.0, "khz": 1e3, "s/s": 1.0, "ks/s": 1e3, "ms/s": 1e6}


def is_dynoware(preamble: Sequence[str]) -> bool:
    """Whether the first line names the program."""
    return bool(preamble) and preamble[0].lstrip('"').lower().startswith("dynoware")


def keys_of(preamble: Sequence[str]) -> dict[str, str]:
    """The lines above a table as keys and values.

    >>> keys_of(["DynoWare,Version 2.5.1.2", "Sampling rate [Hz]:,10000", "# fs = 51.2 kHz", "Date:, "])
    {'DynoWare': 'Version 2.5.1.2', 'Sampling rate [Hz]': '10000', 'fs': '51.2 kHz', 'Date': ''}
    """
    found = (_KEY.fullmatch(line.strip().lstrip("#%! ")) for line in preamble)
    return {match["key"].strip(): match["value"].strip() for match in found if match}


def stated_rate(keys: dict[str, str]) -> float | None:
    """Sample rate in Hz that a header states with its unit, or under a key in Hz; None where it does not."""
    for key, value in keys.items():
        name = _RATE.fullmatch(key)
        number = re.fullmatch(r"(?P<number>[\d.,]+(e[+-]?\d+)?)\s*(?P<unit>k?hz|[km]?s/s)?", value, re.I)
        unit = ((name and name["unit"]) or (number and number["unit"]) or "").lower()
        if name and number and unit:
            try:
                return float(number["number"].replace(",", ".")) * _TO_HZ[unit]
            except ValueError:
                continue
    return None


def stated_rows(keys: dict[str, str]) -> int | None:
    """The number of samples that a header promises."""
    for key, value in keys.items():
        if _COUNT.fullmatch(key) and value.isdecimal():
            return int(value)
    return None


def rows_against_header(where: str, rows: int, promised: int | None) -> list[Notice]:
    """The header promised another number of rows than there are: the file is a part of a measurement, or cut short."""
    if promised is None or promised == rows:
        return []
    message = f"the header says {promised} samples per channel, the file has {rows} rows; the rows are taken"
    return [Notice("rows-against-header", message, where)]
