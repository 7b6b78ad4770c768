"""What a process costs: wall and CPU seconds, and the most memory it held, over repeats that take turns."""

import os
import subprocess
import sys
import time
from statistics import median
from typing import NamedTuple


class Cost(NamedTuple):
    """One run of a command."""

    wall: float  # s
    cpu: float  # s, user and system, the process and its children
    peak: float  # MB, largest resident set
    output: str  # what it printed


def run(command: list[str]) -> Cost:
    """Run a command to its end; anything but success stops the benchmark with what the command said."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=sys.stderr, text=True)
    output = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    if status:
        sys.exit(f"error: {' '.join(command)}: ended with status {os.waitstatus_to_exitcode(status)}; see above")
    return Cost(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, output)


def take_turns(commands: dict[str, list[str]], repeats: int) -> dict[str, list[Cost]]:
    """Each command `repeats` times, one after the other in turns, so that a busy minute meets them all alike."""
    for command in commands.values():
        run(command)  # the caches are warm from here on
    costs: dict[str, list[Cost]] = {name: [] for name in commands}
    for _ in range(repeats):
        for name, command in commands.items():
            costs[name].append(run(command))
    return costs


def spread(values: list[float], form: str = ".2f") -> str:
    """The least and the median of repeats, as they stand in the tables."""
    return f"{min(values):{form}} / {median(values):{form}}"


def table(head: tuple[str, ...], *rows: tuple[str, ...]) -> str:
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ("---",) * len(head), *rows])
