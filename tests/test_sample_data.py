"""The sample recordings are what their recipes make, and every recipe finds what it expects."""

import csv
import hashlib
import json
from io import StringIO
from pathlib import Path

import h5py
import low_immersion_cuts
import numpy as np
import pytest

from millcal import pipeline
from millcal.cli import main
from millcal.io.recipes import read_recipe

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "sample_data"
LOG = low_immersion_cuts.FOLDER / "cuts.csv"
SIMULATED = sorted((ROOT / "recipes" / "simulate").glob("*.toml"))
LOGS = {"cuts.csv"}  # of test cuts, which no recipe simulates
RECIPES = sorted((ROOT / "recipes").glob("*.toml"))


def numbers_of(path: Path) -> dict[str, object]:
    """Datasets and attributes of an HDF5 file: its bytes depend on the version of the compressor too."""
    found: dict[str, object] = {}
    with h5py.File(path) as file:
        found.update({f"@{key}": np.asarray(value).tolist() for key, value in file.attrs.items()})

        def note(name: str, item: h5py.HLObject) -> None:
            found.update({f"{name}@{key}": np.asarray(value).tolist() for key, value in item.attrs.items()})
            if isinstance(item, h5py.Dataset):
                found[name] = hashlib.sha256(np.ascontiguousarray(item[()]).tobytes()).hexdigest()

        file.visititems(note)
    return found


@pytest.mark.parametrize("recipe", SIMULATED, ids=lambda path: path.stem)
def test_the_sample_recordings_are_what_their_recipe_makes(recipe, tmp_path):
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(recipe), "--out", str(tmp_path), "--quiet"])
    assert ended.value.code == 0
    shipped = SAMPLES / recipe.stem
    recorded = sorted(path.name for path in shipped.iterdir() if path.name not in LOGS)
    assert sorted(path.name for path in tmp_path.iterdir()) == recorded
    for made in tmp_path.iterdir():
        if made.suffix == ".h5":
            assert numbers_of(made) == numbers_of(shipped / made.name), made.name
        elif made.suffix == ".json":
            assert json.loads(made.read_text()) == json.loads((shipped / made.name).read_text())
        else:
            assert made.read_bytes() == (shipped / made.name).read_bytes(), made.name


def test_the_log_of_test_cuts_is_what_the_time_domain_says():
    """Exactly but for the motion of cuts that chatter, in which rounding grows."""
    rows = [list(csv.DictReader(StringIO(text))) for text in (low_immersion_cuts.log(), LOG.read_text())]
    for made, shipped in zip(*rows, strict=True):
        assert {key: made[key] for key in made if key not in ("M_um", "chatter_hz")} == {
            key: shipped[key] for key in shipped if key not in ("M_um", "chatter_hz")
        }
        assert float(made["M_um"]) == pytest.approx(float(shipped["M_um"]), rel=0.2, abs=0.2)
        assert float(made["chatter_hz"] or 0) == pytest.approx(float(shipped["chatter_hz"] or 0), abs=2)


def test_every_sample_file_has_its_checksum_and_its_paragraph():
    sums = dict(reversed(line.split("  ")) for line in (SAMPLES / "SHA256SUMS").read_text().splitlines())
    files = {path.relative_to(SAMPLES).as_posix(): path for path in SAMPLES.glob("*/*")}
    assert sums == {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    text = (SAMPLES / "README.md").read_text()
    assert {path.stem for path in SIMULATED} == {path.parent.name for path in files.values()}
    assert all(f"\n## {path.stem}\n" in text for path in SIMULATED)


def test_the_sample_recordings_stay_below_ten_megabytes():
    assert sum(path.stat().st_size for path in SAMPLES.rglob("*") if path.is_file()) < 10e6


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_every_recipe_finds_what_it_expects(path, tmp_path):
    recipe = read_recipe(path)
    assert recipe.expect, "a recipe without [expect] proves nothing"
    found = pipeline.run(recipe, tmp_path / "result")
    if found.skipped:
        pytest.skip(f"the recordings of {path.name} are not here; set MILLCAL_REFERENCE_DATA to their folder")
    assert found.missed == []
