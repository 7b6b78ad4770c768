"""How long a user waits for `millcal --help`: half of it is Python's own start."""

import sys

from measure import spread, table, take_turns


def start(options) -> str:
    """CPU seconds of the help, beside those of an empty Python."""
    commands = {
        "python -c pass": [sys.executable, "-c", "pass"],
        "millcal --help": [sys.executable, "-m", "millcal", "--help"],
    }
    costs = take_turns(commands, max(options.repeats, 10))
    rows = [(f"`{name}`", spread([cost.cpu for cost in costs[name]], ".3f")) for name in commands]
    return table(("command", "CPU s (least / median)"), *rows)
