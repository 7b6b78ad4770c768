"""A result's dependence on the files it was made from, as a rule that make reads.

Only the run itself knows every file that a recipe leads to, so the run says it; `make recipes` then redoes what is stale and
nothing else. The rule is the last file of a good run, and so its own time stands for the whole result folder.
"""

from collections.abc import Iterable
from pathlib import Path


def make_rule(target: Path, inputs: Iterable[Path]) -> str:
    r"""The rule `target: inputs` and an empty rule for each input, so that make redoes the target when an input vanishes.

    >>> print(make_rule(Path("build/slot/inputs.mk"), [Path("sample data/f300.txt")]), end="")
    build/slot/inputs.mk: sample\ data/f300.txt
    sample\ data/f300.txt:
    """
    names = [_escaped(path) for path in dict.fromkeys(inputs)]
    lines = [" ".join([f"{_escaped(target)}:", *names]), *(name.replace("%", r"\%") + ":" for name in names)]
    return "\n".join(lines) + "\n"


def _escaped(path: Path) -> str:
    """A path as make reads it among the prerequisites (a target with % would be a pattern)."""
    return str(path).replace("$", "$$").replace("#", r"\#").replace(" ", r"\ ")
