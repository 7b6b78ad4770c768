"""What is shipped and what is installed: every file of the package, and pinned versions of all that it needs."""

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
REQUIREMENTS = [Requirement(line) for line in [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["dev"]]]


def test_the_wheel_holds_every_file_of_the_package():
    builders = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed")
    shipped = {Path(file.path) for file in builders.WheelBuilder(str(ROOT)).recurse_included_files()}
    present = {path for path in (ROOT / "millcal").rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert shipped == present


@pytest.mark.parametrize("requirement", REQUIREMENTS, ids=str)
def test_every_requirement_is_pinned_to_a_version_it_allows(requirement):
    pins = [line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line]
    versions = {canonicalize_name(name): version for name, version in pins}
    assert versions[canonicalize_name(requirement.name)] in requirement.specifier
