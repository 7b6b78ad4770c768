"""The command line: a registry that imports a command only when it is called.

`millcal --help` must stay under 0.2 s of CPU, so the names and one-line helps stand here and numpy, pandas or matplotlib
are imported by the one command that needs them. Each command is a file of this folder with a function of its name:
parse, call, print. No mathematics and no file formats here.
"""

import importlib
import os
import sys
from typing import Annotated, Any

import typer
from typer._click.exceptions import ClickException, UsageError
from typer.core import TyperGroup

from millcal import __version__
from millcal.errors import MillcalError

COMMANDS = {
    "fit": "The main job: recorded cuts and impact tests to coefficients, a stability map and a report.",
    "inspect": "Say what is in a file of any known format.",
    "ingest": "Bring any file into the recording format, with units, axes and signs stated.",
    "frf": "Impact tests to an FRF matrix with coherence and a table of the hits.",
    "export": "An FRF to the files of other programs (UFF, CutPro, CSV), or theirs to HDF5.",
    "modes": "An FRF to modes: frequency, damping, stiffness and shape, with intervals.",
    "forces": "Cutting forces and coefficients from accelerations in a cut and an FRF, without a dynamometer.",
    "identify": "Cutting coefficients from dynamometer cuts, or from accelerations, with intervals and a verdict.",
    "stability": "Limit depth against spindle speed from coefficients and an FRF or modes.",
    "judge": "Was that chatter: a recorded cut judged stable, period-n or chatter, with its frequency.",
    "simulate": "Write synthetic recordings with known truth from a recipe.",
    "study": "A published experiment again, beside its own numbers.",
    "report": "Make a result folder's report again, without computing.",
    "schema": "Print the JSON schema of recipes.",
}


INTERRUPTED = 130

# The matrices here are small and many: threads cost more than they bring (a modal fit takes a third of the time with one),
# and with one the sums have one order, so that the number of cores is not in the result. Who sets these is obeyed.
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


class _LazyGroup(TyperGroup):
    """A group whose commands are imported when they are called, not when they are listed."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in COMMANDS:
            return None
        if cmd_name not in self.commands:
            function = getattr(importlib.import_module(f"millcal.cli.{cmd_name}"), cmd_name)
            single = typer.Typer(add_completion=False, rich_markup_mode=None)
            single.command(name=cmd_name)(function)
            command: Any = typer.main.get_command(single)
            command.help = command.help.replace("Example:", "\b\nExample:")  # in one line, so that it can be copied
            self.commands[cmd_name] = command
        return self.commands[cmd_name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        from typer._click.shell_completion import CompletionItem

        return [CompletionItem(name, help=text) for name, text in COMMANDS.items() if name.startswith(incomplete)]


app = typer.Typer(
    cls=_LazyGroup,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"millcal {__version__}")
        raise typer.Exit


@app.callback()
def millcal(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Calibrate milling models offline, from recorded files.

    Start with: millcal fit RECIPE.toml --out DIR
    """


def main(arguments: list[str] | None = None) -> None:
    """Run one command; every failure is one line on stderr and an exit code of the contract."""
    for name in THREADS:  # before numpy is imported
        os.environ.setdefault(name, "1")
    try:
        code = app(arguments, prog_name="millcal", standalone_mode=False)
    except UsageError as problem:
        path = problem.ctx.command_path if problem.ctx else "millcal"
        message = " ".join(problem.format_message().split()).rstrip(".")
        typer.echo(f"error: {path}: {message}; see '{path} --help'", err=True)
        sys.exit(2)
    except ClickException as problem:
        typer.echo(f"error: {problem.format_message()}", err=True)
        sys.exit(2)
    except MillcalError as problem:
        typer.echo("error: " + " ".join(str(problem).split()), err=True)
        sys.exit(3)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except SystemError as problem:  # what an interrupt becomes within a compiled loop
        if not isinstance(problem.__cause__ or problem.__context__, KeyboardInterrupt):
            raise
        code = INTERRUPTED
    if code == INTERRUPTED:  # typer makes the code of a KeyboardInterrupt, and says nothing
        typer.echo("error: millcal: interrupted; nothing was left half written", err=True)
    sys.exit(code if isinstance(code, int) else 0)
