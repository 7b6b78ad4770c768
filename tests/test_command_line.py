"""The command line as a whole: light to start, documented to the last option, one line when it is misused."""

import inspect
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import typer

from millcal import __version__
from millcal.cli import COMMANDS, app, main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
HEAVY = {"numpy", "scipy", "pandas", "matplotlib", "cvxpy", "numba", "h5py", "pydantic", "jinja2", "rich"}

group = typer.main.get_command(app)


def command(name):
    return group.get_command(None, name)


def options_of(name):
    """Every way to write an option of a command, --quiet and -q alike."""
    return {spelling for parameter in command(name).params for spelling in (*parameter.opts, *parameter.secondary_opts)}


def docstring_of(name):
    return inspect.getdoc(getattr(import_module(f"millcal.cli.{name}"), name)) or ""


def examples():
    """Every `millcal ...` line that is shown to users: in the README's code blocks and in the docstrings of the commands."""
    blocks = "\n".join(re.findall(r"^```\w*\n(.*?)^```", README, re.DOTALL | re.MULTILINE)).replace("\\\n", " ")
    lines = re.findall(r"^ *(?:\$ )?(millcal .*)$", blocks, re.MULTILINE)
    for name in COMMANDS:
        lines += re.findall(r"^Examples?: (millcal .*)$", docstring_of(name).replace("\\\n", " "), re.MULTILINE)
    return [shlex.split(line, comments=True) for line in lines]


def run_main(arguments):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return end.value.code


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)], ids=" ".join
)
def test_help_is_given_without_importing_anything_heavy(arguments):
    script = (
        "import sys\n"
        "from millcal.cli import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print('heavy:', *sorted({HEAVY!r} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    brought_by_typer = ["pydantic"] if arguments[0] in COMMANDS else []  # it converts a command's annotations
    assert run.stdout.splitlines()[-1].split()[1:] in ([], brought_by_typer)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_documented_in_the_readme(name):
    assert re.search(rf"^\| `{name}\b", README, re.MULTILINE), f"the README's table of commands has no row `{name} ...`"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_says_what_it_does_and_shows_an_example(name):
    assert len(docstring_of(name).splitlines()[0]) > 20
    assert f"millcal {name} " in docstring_of(name) + " "


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_a_help(name):
    without = [parameter.name for parameter in command(name).params if not getattr(parameter, "help", None)]
    assert without == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_speaks_json_can_be_quiet_and_takes_a_seed(name):
    assert {"--json", "--quiet", "--seed"} <= options_of(name)


def test_every_example_uses_only_commands_and_options_that_exist():
    shown = examples()
    assert {words[1] for words in shown} >= set(COMMANDS)
    for words in shown:
        if words[1].startswith("-"):
            continue
        assert words[1] in COMMANDS, shlex.join(words)
        used = {word.split("=")[0] for word in words[2:] if re.match(r"--?[a-zA-Z]", word)}
        assert used <= options_of(words[1]), shlex.join(words)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_shows_the_example_in_one_line_to_copy(name, capsys):
    assert run_main([name, "--help"]) == 0
    shown = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for example in re.findall(r"^Example: .*$", docstring_of(name), re.MULTILINE):
        assert example in shown


def test_no_command_is_one_line_and_exit_code_2(capsys):
    assert run_main([]) == 2
    assert re.fullmatch(r"error: millcal: .*; see 'millcal --help'\n", capsys.readouterr().err)


def test_an_interrupt_is_one_line_and_exit_code_130(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("millcal.cli.schema"), "reply", interrupted)
    assert run_main(["schema"]) == 130
    assert re.fullmatch(r"error: millcal: interrupted; .*\n", capsys.readouterr().err)


def test_an_unknown_command_is_one_line_and_exit_code_2(capsys):
    assert run_main(["milll"]) == 2
    assert re.fullmatch(r"error: .*'milll'.*; .*\n", capsys.readouterr().err)


@pytest.mark.parametrize("name", COMMANDS)
def test_an_unknown_option_is_one_line_and_exit_code_2(name, capsys):
    assert run_main([name, "--nonsense"]) == 2
    assert re.fullmatch(rf"error: millcal {name}: .*--nonsense.*; .*\n", capsys.readouterr().err)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_missing_argument_is_one_line_and_exit_code_2(name, capsys):
    if not any(parameter.required for parameter in command(name).params):
        pytest.skip(f"{name} needs no argument")
    assert run_main([name]) == 2
    assert re.fullmatch(rf"error: millcal {name}: .*; .*\n", capsys.readouterr().err)


def test_python_dash_m_millcal_is_the_command():
    run = subprocess.run([sys.executable, "-m", "millcal", "--version"], capture_output=True, text=True, check=True)
    assert run.stdout == f"millcal {__version__}\n"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_completion_script_is_printed_for_the_shell(shell, monkeypatch, capsys):
    monkeypatch.setenv("_MILLCAL_COMPLETE", f"source_{shell}")
    assert run_main([]) == 0
    assert "complete" in capsys.readouterr().out


def test_the_shell_completes_commands(monkeypatch, capsys):
    for key, value in {"_MILLCAL_COMPLETE": "complete_bash", "COMP_WORDS": "millcal i", "COMP_CWORD": "1"}.items():
        monkeypatch.setenv(key, value)
    assert run_main([]) == 0
    assert capsys.readouterr().out.split() == [name for name in COMMANDS if name.startswith("i")]


def test_the_shell_completes_options(monkeypatch, capsys):
    for key, value in {"_MILLCAL_COMPLETE": "complete_bash", "COMP_WORDS": "millcal fit --", "COMP_CWORD": "2"}.items():
        monkeypatch.setenv(key, value)
    assert run_main([]) == 0
    assert "--out" in capsys.readouterr().out.split()


def test_every_recipe_key_is_explained_in_the_schema_and_named_in_the_readme():
    from millcal.io.recipe_tables import RecipeTables

    schema = RecipeTables.model_json_schema()
    unexplained, unnamed = [], []
    queue, seen = [("", schema)], set()
    while queue:
        place, table = queue.pop()
        for key, value in table.get("properties", {}).items():
            if "description" not in value:
                unexplained.append(place + key)
            if not re.search(rf"[`\[]{key}[`\].]", README) and not place.startswith("simulate."):
                unnamed.append(place + key)
            for name in re.findall(r"'#/\$defs/(\w+)'", str(value)):
                visit = (name, f"{place}{key}.".startswith("simulate."))
                if visit not in seen:
                    seen.add(visit)
                    queue.append((f"{place}{key}.", schema["$defs"][name]))
    assert (unexplained, unnamed) == ([], [])


@pytest.mark.parametrize("command", ["frf", "ingest", "export", "modes", "identify"])
def test_no_command_writes_over_what_it_reads(command, tmp_path, capsys):
    """Not by its own name, and not by a link to it."""
    recording = tmp_path / "tap.h5"
    recording.write_bytes(b"not read before the names are checked")
    link = tmp_path / "link.h5"
    link.symlink_to(recording)
    for out in (recording, link):
        with pytest.raises(SystemExit) as ended:
            main([command, str(recording), "-o", str(out)])
        assert ended.value.code == 2
        assert "would be written over" in capsys.readouterr().err
    assert recording.read_bytes().startswith(b"not read")
