"""The verbs of the command line; each is a thin skin over one call of the library.

Libraries are imported inside the verbs, so that ``simbench --help`` answers at once.
"""

import sys
import traceback
from collections.abc import Sequence

import click

from simbench.cli.converting import convert
from simbench.cli.judging import audit, bugs, check, hunt
from simbench.cli.lists import list_
from simbench.cli.options import DONE, FAILED, INTERNAL, INTERRUPTED, WRONG_INPUT
from simbench.cli.reporting import report
from simbench.cli.scenes import generate, info, run
from simbench.cli.studies import campaign, compare
from simbench.errors import FilterFailure, SimbenchError
from vislam import __version__


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="simbench")
def cli() -> None:
    """A test bench for visual-inertial filters."""


for verb in (
    generate,
    run,
    info,
    convert,
    audit,
    check,
    bugs,
    hunt,
    campaign,
    compare,
    report,
    list_,
):
    cli.add_command(verb)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a verb and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        exit_status = cli.main(arguments, prog_name="simbench", standalone_mode=False)
    except (KeyboardInterrupt, click.Abort):
        return _failed(INTERRUPTED, "Interrupted; finished files are whole, unfinished ones gone.")
    except click.ClickException as error:
        error.show()
        return WRONG_INPUT
    except MemoryError:
        return _failed(
            WRONG_INPUT, "Not enough memory for this; take less data or fewer processes."
        )
    except Exception as error:  # the last resort: no verb ends in a traceback
        if "--debug" in arguments:
            traceback.print_exc()
        if isinstance(error, FilterFailure):
            return _failed(FAILED, f"The filter failed: {error}")
        if isinstance(error, SimbenchError):
            return _failed(WRONG_INPUT, str(error))
        return _failed(
            INTERNAL, f"Internal error, {type(error).__name__}: {error}. --debug shows where."
        )
    return exit_status or DONE  # a judging verb returns its own


def _failed(status: int, message: str) -> int:
    click.echo(message, err=True)
    return status
