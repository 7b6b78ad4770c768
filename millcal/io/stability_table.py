"""The lobes as a table for other programs: CSV, a line for each crossing of each spindle speed, lowest first.

`rpm, limit_mm, crossing, ap_mm, kind, chatter_hz, lobe, loses`: the first limit of the speed stands on each of its lines, then
the crossing of the line. `loses` is 1 where stability is lost with growing depth, 0 where a multiplier comes back. A speed
without a limit has one line with nothing but its speed. With a band: `limit_low_mm, limit_high_mm`, 95 %.
"""

import csv
from io import StringIO

from millcal.data import StabilityMap
from millcal.io.stability_summary import summarise_stability

COLUMNS = ("rpm", "limit_mm", "crossing", "ap_mm", "kind", "chatter_hz", "lobe", "loses")
BAND = ("limit_low_mm", "limit_high_mm")
DIGITS = 10  # of every number: a round trip loses less than any method knows


def stability_table(found: StabilityMap) -> str:
    """The table as text, lines ended as RFC 4180 wants them."""
    banded = found.limit_low is not None
    text = StringIO()
    lines = csv.writer(text)
    lines.writerow([*COLUMNS, *(BAND if banded else ())])
    for entry in summarise_stability(found)["limit"]:
        first = next((crossing for crossing in entry["crossings"] if crossing["loses"]), {})
        band = [_number(bound) for bound in first.get("ap_mm_ci95", (None, None))] if banded else []
        rpm, limit = _number(entry["rpm"]), _number(first.get("ap_mm"))
        for number, crossing in enumerate(entry["crossings"], 1):
            depth, frequency = _number(crossing["ap_mm"]), _number(crossing["chatter_hz"])
            lobe = "" if crossing["lobe"] is None else crossing["lobe"]
            loses = int(crossing["loses"])
            lines.writerow([rpm, limit, number, depth, crossing["kind"], frequency, lobe, loses, *band])
        if not entry["crossings"]:
            lines.writerow([rpm, *[""] * (len(COLUMNS) - 1 + len(band))])
    return text.getvalue()


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.{DIGITS}g}"
