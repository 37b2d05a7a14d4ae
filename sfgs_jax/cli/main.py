"""Entry point: chooses the command and turns errors into one sentence and an exit status."""

import signal
import sys
from types import FrameType

from sfgs_jax import __version__
from sfgs_jax.cli.doctor import doctor_command
from sfgs_jax.cli.evaluate import eval_command
from sfgs_jax.cli.run import run_command
from sfgs_jax.cli.view import view_command
from sfgs_jax.geometry import InputError

COMMANDS = {
    "run": (run_command, "track and map a recording"),
    "eval": (eval_command, "compute a run's metrics and report again"),
    "view": (view_command, "show a run's map in the browser"),
    "doctor": (doctor_command, "say what the installation sees and what is missing"),
}

EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED = 1, 2, 130


def _usage() -> str:
    lines = [f"  {name:<8}{text}" for name, (_, text) in COMMANDS.items()]
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


def _terminate(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Run a command.

    Returns:
        0, or 1 where the work failed, 2 where the input can't be used, 130 where it was interrupted.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_usage())
        return 0 if arguments else EXIT_INPUT
    if arguments[0] == "--version":
        print(__version__)
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        print(f"sfgs-jax: there is no command {name!r}; choose from {', '.join(COMMANDS)}.", file=sys.stderr)
        return EXIT_INPUT
    # A polite kill saves what there is, as Ctrl-C does.
    signal.signal(signal.SIGTERM, _terminate)
    try:
        return COMMANDS[name][0](rest)
    except InputError as error:
        print(f"sfgs-jax: {error}", file=sys.stderr)
        return EXIT_INPUT
    except OSError as error:
        print(f"sfgs-jax: {error.strerror or error}: {error.filename or 'a file'}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        print("sfgs-jax: interrupted.", file=sys.stderr)
        return EXIT_INTERRUPTED
