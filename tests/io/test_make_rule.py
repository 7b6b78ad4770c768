"""The rule that a good run leaves for make, read by make itself."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from millcal.io.make_rule import make_rule


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("name", ["f300.txt", "feed 300 mm.txt", "cut#1.txt", "100%.txt", "cost$.txt"])
def test_make_redoes_a_result_when_an_input_is_newer_or_gone_and_only_then(tmp_path, name):
    source, target = tmp_path / name, tmp_path / "inputs.mk"
    source.touch()
    target.write_text(make_rule(Path("inputs.mk"), [Path(name), Path(name)]))
    (tmp_path / "Makefile").write_text("inputs.mk:\n\t@echo redone\n$(eval $(file <inputs.mk))\n")

    def is_redone():
        return "redone" in subprocess.run(["make"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout

    os.utime(source, (1, 1))
    assert not is_redone()
    os.utime(target, (2, 2))
    os.utime(source, (3, 3))
    assert is_redone()
    source.unlink()
    assert is_redone()
