"""The command line: parse, call one function, print, return a code. Heavy imports wait until a command runs."""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module

import click

from vtrack_batch import __version__
from vtrack_batch.errors import VtrackError

COMMANDS = (
    "init", "check", "run", "status", "explain", "inspect", "quarantine", "verify", "repair", "gc", "doctor", "schema",
    "evaluate", "simulate", "match", "track", "learn", "calibrate",
)  # fmt: skip


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called or listed: one module each, all light."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands in the order in which they are used."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command *cmd_name*; None for an option in its place; what is misspelt is suggested."""
        if cmd_name.startswith("-"):
            return None
        if cmd_name not in COMMANDS:
            raise click.exceptions.NoSuchCommand(cmd_name, possibilities=COMMANDS, ctx=ctx)
        command: click.Command = import_module(f"vtrack_batch.cli.{cmd_name}").command
        return command


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="vtrack-batch")
def group() -> None:
    """\b
    Examples:
      vtrack-batch init my-survey --from /archive/frames
      vtrack-batch run my-survey/survey.yaml

    Turn archives of time-stamped aerial frames into traffic tables.
    """


def main() -> None:
    """Run the command line and exit with the code that each outcome has: see ``errors``."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    signal.signal(signal.SIGTERM, _stop)
    sys.exit(_outcome(sys.argv[1:]))


def _stop(*_: object) -> None:
    """Unwind as Ctrl-C does: workers end, the lock is let go; a second signal ends it at once."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    click.echo("stopped: what is finished is kept, a new run goes on from there", err=True)
    sys.exit(143)


def _outcome(arguments: list[str]) -> int:
    try:
        result = group.main(arguments, prog_name="vtrack-batch", standalone_mode=False)
    except click.exceptions.Abort:
        click.echo("interrupted", err=True)
        return 130
    except click.ClickException as problem:
        problem.show()
        return problem.exit_code
    except VtrackError as problem:
        click.echo(str(problem), err=True)
        return problem.exit_code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as problem:
        click.echo(f"{problem.filename or 'input or output'}: {problem.strerror or problem}", err=True)
        return 74
    except Exception as problem:  # the one place where a bug is told to the user
        if os.environ.get("VTRACK_DEBUG"):
            raise
        click.echo(f"bug: {type(problem).__name__}: {problem}\nVTRACK_DEBUG=1 shows where; please report it.", err=True)
        return 1
    return result if isinstance(result, int) else 0
