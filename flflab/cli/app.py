"""All commands of ``flflab`` in one list; each lives in the file of its name and is loaded when it
is asked for.
"""

from importlib import import_module
from importlib.metadata import version
from typing import Annotated, Any, cast

import typer
from typer.core import TyperGroup

from flflab.cli.ending import InterruptedCommandError, is_interruption
from flflab.cli.quantities import where_quotes_are_missing
from flflab.printable import nearest

COMMANDS = {  # each with what ``flflab --help`` says of it, in a line of 80 columns
    "validate": "Run a study on a bench and compare the camera with its model.",
    "compare": "Compare views and virtual depths measured elsewhere with a model.",
    "model": "Print every property that the model gives for a camera.",
    "image": "Form the picture of a scene and write it.",
    "measure": "Measure one picture.",
    "depth": "Make a depth map with its uncertainty, of a picture or a run.",
    "refocus": "Focus a picture anew, at any distance or everywhere.",
    "accuracy": "Show what accuracy costs, and how far the model can be trusted.",
    "plan": "Print the steps, duration and uncertainty of a study.",
    "design": "Search the configurations that meet requirements.",
    "align": "Align array and sensor, by white pictures.",
    "calibrate": "Find zeros and scales of the stages and sizes of the optics.",
    "sweep": "Home and take every frame of a study.",
    "resume": "Continue an interrupted run.",
    "report": "Measure and compare recorded runs again; rewrite their reports.",
    "export": "Write a recorded run as one file for other programs.",
    "bench": "Look at a bench and move it by hand.",
    "sim": "Serve a simulated bench until Ctrl-C.",
    "target": "Write a target in its true size, to be printed.",
    "new": "Write a commented copy of a built-in file to begin from.",
}
GIVEN = "flflab.given"  # where a context keeps the words of the command line
UNUSABLE = cast(
    type[Exception], typer.BadParameter.__base__
)  # click's UsageError, which a word too many raises; typer names its kinds alone


class Commands(TyperGroup):
    """The commands by name; a command that draws or compiles does not slow down the others'
    start.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """Every name, in the order of the help text."""
        return list(COMMANDS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The list of ``--help``: no command is loaded for its line."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name, None where there is none."""
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"flflab.cli.{cmd_name}")
        group = getattr(module, "app", None)
        if group is None:
            group = typer.Typer(
                add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
            )
            group.command(cmd_name)(getattr(module, cmd_name))
        command = typer.main.get_command(cast(typer.Typer, group))
        command.name = cmd_name
        command.short_help = COMMANDS[cmd_name]
        return command

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that was given; where there is none of that name, the nearest is named."""
        try:
            return super().resolve_command(ctx, args)
        except UNUSABLE as error:
            if near := nearest(args[0] if args else "", COMMANDS):
                cast(Any, error).message += f" Did you mean '{near}'?"
            raise

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep what was given, for ``invoke``."""
        ctx.meta[GIVEN] = list(args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; its Ctrl-C goes to ``main``, which says so, and a word too many that is
        a unit is told to belong in quotes.
        """
        try:
            return super().invoke(ctx)
        except BaseException as error:
            if is_interruption(error):
                raise InterruptedCommandError from error
            if type(error) is UNUSABLE and (quoted := where_quotes_are_missing(ctx.meta[GIVEN])):
                cast(Any, error).message += f"; a number and its unit go into quotes: {quoted}"
            raise


app = typer.Typer(
    name="flflab",
    cls=Commands,
    help=(
        "Run the bench of a focused light field camera and say, with numbers, whether the camera"
        " does what its model says."
    ),
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},  # the commands inherit it
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _tell_version(asked: bool) -> None:
    if asked:
        typer.echo(f"flflab {version('flflab')}")
        raise typer.Exit


@app.callback()
def flflab(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_tell_version, is_eager=True, help="Say which version this is."
        ),
    ] = False,
) -> None:
    """Run the bench of a focused light field camera and say, with numbers, whether the camera does
    what its model says.
    """
