"""The verb that says what there is."""

from collections.abc import Mapping
from pathlib import Path

import click

from simbench.cli.options import options
from simbench.printing import print_json

PACKAGE = Path(__file__).parents[1]
#: Printed as they are, by their place in the package.
FILES = {"schema": "scenario/schema.json", "layout": "mcap/layout.json"}
LISTS = ("filters", "checks", "trajectories", "landmarks", "bugs", *FILES)


@click.command("list")
@click.argument("what", type=click.Choice(LISTS))
@options()
def list_(what: str, as_json: bool) -> None:
    """Say what there is, a line each.

    schema is the JSON schema of a scene file; layout is a layout of a recording's topics for
    Foxglove and Lichtblick.
    """
    if what in FILES:
        click.echo((PACKAGE / FILES[what]).read_text(encoding="utf-8"), nl=False)
        return
    table = _table(what)
    if as_json:
        print_json(table)
    else:
        width = max(map(len, table))
        for name, about in table.items():
            click.echo(f"{name:{width}}  {about}")


def _table(what: str) -> Mapping[str, str]:
    if what == "filters":
        from simbench.filters import known

        return known()
    if what == "checks":
        from simbench.checks.conformance import CHECKS

        return CHECKS
    if what == "bugs":
        from simbench.bugs import BUGS

        return {name: bug.what for name, bug in BUGS.items()}
    from simbench.scenario import LANDMARKS, TRAJECTORIES

    return TRAJECTORIES if what == "trajectories" else LANDMARKS
