"""Entry point: chooses the command and turns errors into one sentence and an exit status."""

import io
import sys
from collections.abc import Callable, Mapping
from typing import NamedTuple

from sfgs_jax import __version__
from sfgs_jax.arrays import InputError, keep_freed_memory
from sfgs_jax.cli._batch import batch_command
from sfgs_jax.cli._check import check_command
from sfgs_jax.cli._doctor import doctor_command
from sfgs_jax.cli._evaluate import eval_command
from sfgs_jax.cli._export import export_command
from sfgs_jax.cli._interruption import interruptible
from sfgs_jax.cli._merge import merge_command
from sfgs_jax.cli._render import render_command
from sfgs_jax.cli._run import run_command
from sfgs_jax.cli._view import view_command


class Command(NamedTuple):
    """A command of `sfgs-jax`: a function from its arguments to an exit status, and a line of help."""

    run: Callable[[list[str]], int]
    help: str


COMMANDS = {
    "check": Command(check_command, "look for what would spoil a run of a recording"),
    "run": Command(run_command, "track and map a recording"),
    "batch": Command(batch_command, "track and map the recordings of a list, several at once"),
    "merge": Command(merge_command, "merge the maps of two runs of one camera"),
    "eval": Command(eval_command, "compute a run's metrics and report again"),
    "view": Command(view_command, "show a run's map in the browser"),
    "render": Command(render_command, "draw a map along a path: images, depth or a video"),
    "export": Command(export_command, "write a map in the format of another program"),
    "doctor": Command(doctor_command, "list what the installation has and what it lacks"),
}
"""The commands by name."""

EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED = 1, 2, 130


def main(arguments: list[str] | None = None, *, commands: Mapping[str, Command] = COMMANDS) -> int:
    """Run a command.

    Args:
        arguments: words of the command line; None takes the process's own.
        commands: the commands by name.

    Returns:
        0, or 1 if the work failed, 2 if the input can't be used, 130 if it was interrupted.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Names of files may hold bytes that are no text.
        sys.stdout.reconfigure(errors="backslashreplace")
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_usage(commands))
        return 0 if arguments else EXIT_INPUT
    if arguments[0] == "--version":
        print(__version__)
        return 0
    name, *rest = arguments
    if name not in commands:
        print(f"sfgs-jax: there is no command {name!r}; choose from {', '.join(commands)}.", file=sys.stderr)
        return EXIT_INPUT
    keep_freed_memory()
    try:
        # A polite kill saves the work so far, as Ctrl-C does.
        with interruptible():
            return commands[name].run(rest)
    except InputError as error:
        print(f"sfgs-jax: {error}", file=sys.stderr)
        return EXIT_INPUT
    except OSError as error:
        print(f"sfgs-jax: {error.strerror or error}: {error.filename or 'a file'}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        print("sfgs-jax: interrupted.", file=sys.stderr)
        return EXIT_INTERRUPTED


def _usage(commands: Mapping[str, Command]) -> str:
    lines = [f"  {name:<8}{command.help}" for name, command in commands.items()]
    return "\n".join(
        [
            f"sfgs-jax {__version__}: RGB-D SLAM with Gaussian-splat maps",
            "",
            "usage: sfgs-jax COMMAND ...",
            "",
            *lines,
            "",
            "Each command explains itself with --help. Try: sfgs-jax run synthetic",
        ]
    )
