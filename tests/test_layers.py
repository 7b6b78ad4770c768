"""The walls of the house: who may import whom, and where each third-party package lives."""

import ast
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EVERYBODY_MAY_IMPORT = {"", "units"}  # "" is the package itself: its version

MAY_IMPORT = {
    "": set(),
    "units": set(),
    "errors": set(),
    "numerics": {"numerics", "errors"},
    "physics": {"physics", "numerics", "errors"},
    "data": {"physics", "errors"},
    "stages": {"data", "physics", "numerics", "errors"},  # and its own family of files, see below
    "simulation": {"simulation", "data", "physics", "numerics", "errors"},
    "io": {"io", "data", "physics", "errors"},
    "report": {"report", "data", "errors"},
    "studies": {"studies", "stages", "data", "physics", "numerics", "errors"},
    "pipeline": {"stages", "io", "report", "data", "errors"},
    "batch": {"pipeline", "stages", "io", "report", "data", "errors"},
    "__main__": {"cli"},
}
MAY_IMPORT["cli"] = {"cli", *MAY_IMPORT} - {"", "__main__"}

HOMES = {
    "h5py": "millcal/io/",
    "matplotlib": "millcal/report/paper/sheet.py",
    "typer": "millcal/cli/",
    "cvxpy": "millcal/numerics/receding_horizon.py",
    "dask": "millcal/batch.py",
    "distributed": "millcal/batch.py",
}

PATHS = sorted((ROOT / "millcal").rglob("*.py"))


def module_of(path: Path) -> str:
    """millcal/io/recipes.py -> millcal.io.recipes; a folder's __init__.py is the folder."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in PATHS}


@dataclass(frozen=True)
class Import:
    """One imported module, in the words of the importing file."""

    module: str
    line: int
    relative: bool = False


@cache
def imports_of(source: str) -> list[Import]:
    """Every import of a file, those inside functions and for type checking too: an arrow is an arrow.

    `from millcal.stages import frf` names a module, `from millcal.data import Frf` names one through what it holds.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [Import(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parent = node.module or ""
            names = {f"{parent}.{alias.name}" for alias in node.names}
            found += [
                Import(name if name in MODULES else parent, node.lineno, node.level > 0) for name in sorted(names)
            ]
    return found


def room_of(module: str) -> str:
    """millcal.io.recipes -> io, millcal -> ''."""
    return [*module.split("."), ""][1]


def family_of(module: str) -> str:
    """The stage a file of stages/ belongs to: coefficients_nls.py and coefficients/nls.py are both the stage coefficients."""
    return [*module.split("."), "", ""][2].split("_")[0]


def wrong_arrows(module: str, source: str) -> list[str]:
    """The imports of a file that its layer forbids, each as `file:line: why`."""
    room = room_of(module)
    wrong = []
    for found in imports_of(source):
        if found.relative:
            wrong.append(f"{module}:{found.line}: imports are absolute here")
        if found.module.split(".")[0] != "millcal":
            continue
        to = room_of(found.module)
        is_allowed = to in MAY_IMPORT[room] | EVERYBODY_MAY_IMPORT
        if room == to == "stages":
            is_allowed = family_of(found.module) == family_of(module)
        if not is_allowed:
            wrong.append(f"{module}:{found.line}: {room or 'millcal'} imports {found.module}")
    return wrong


@pytest.mark.parametrize("module", MODULES)
def test_a_file_imports_only_what_its_layer_allows(module):
    assert room_of(module) in MAY_IMPORT, f"{module} stands in no room of the layer table; give it one"
    assert wrong_arrows(module, MODULES[module].read_text()) == []


@pytest.mark.parametrize("package", HOMES)
def test_a_third_party_package_is_imported_in_its_home_only(package):
    strays = [
        f"{path.relative_to(ROOT)}:{found.line}"
        for path in PATHS
        for found in imports_of(path.read_text())
        if found.module.split(".")[0] == package and not path.relative_to(ROOT).as_posix().startswith(HOMES[package])
    ]
    assert strays == []


def test_no_imports_run_in_a_circle():
    graph = {
        module: {found.module for found in imports_of(path.read_text()) if found.module in MODULES}
        for module, path in MODULES.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


@pytest.mark.parametrize("room", ["numerics", "physics", "data", "stages", "simulation"])
def test_who_predicts_solves_or_infers_neither_prints_nor_opens_files(room):
    """Files are io's, words are the command line's; randomness comes in as a generator."""
    wrong = []
    for module, path in MODULES.items():
        if room_of(module) != room:
            continue
        tree = ast.parse(path.read_text())
        calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
        names = {call.id for call in calls if isinstance(call, ast.Name)} & {"print", "open", "input"}
        methods = {call.attr for call in calls if isinstance(call, ast.Attribute)} & {
            *("read_text", "write_text", "read_bytes", "write_bytes", "loadtxt", "savetxt", "load", "save", "savez"),
            *("seed", "default_rng"),
        }
        wrong += [f"{module}: {name}()" for name in sorted(names | methods)]
    assert wrong == []


def test_there_is_no_drawer_for_everything():
    assert [path for path in PATHS if path.stem in {"utils", "util", "helpers", "misc", "common"}] == []


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("millcal.physics.cutter", "from millcal.io.recipes import read_recipe"),
        ("millcal.numerics.spectra", "def f():\n    import millcal.physics.cutter"),
        ("millcal.stages.frf", "from millcal.stages import conditioning"),
        ("millcal.stages.frf", "from millcal.stages.coefficients.average import fit"),
        ("millcal.report.page", "from millcal.stages.frf import estimate_frf"),
        ("millcal.io.recordings", "from . import formats"),
    ],
)
def test_a_wrong_arrow_is_seen(module, source):
    assert wrong_arrows(module, source)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("millcal.stages.coefficients", "from millcal.stages.coefficients_nls import fit"),
        ("millcal.stages.coefficients.nls", "from millcal.stages.coefficients.average import fit"),
        ("millcal.stages.frf", "from millcal import __version__, data\nfrom millcal.units import SI"),
        ("millcal.cli.fit", "from millcal.pipeline import run\nfrom millcal.io.recipes import read_recipe"),
    ],
)
def test_a_right_arrow_is_let_through(module, source):
    assert wrong_arrows(module, source) == []
