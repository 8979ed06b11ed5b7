"""What the verbs share: their options, exit status, and the opening of a source."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simbench.errors import InputError

if TYPE_CHECKING:
    from simbench.dataset import Dataset

DONE, FAILED, WRONG_INPUT, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 130


class Gate(click.ParamType[float | str]):
    """A probability, or ``none``."""

    name = "P|none"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float | str:
        """The probability as a number in (0, 1)."""
        if value == "none":
            return "none"
        try:
            probability = float(value)
        except ValueError:
            probability = -1.0
        if not 0 < probability < 1:
            self.fail(f"expected a probability between 0 and 1, or none, got {value!r}", param, ctx)
        return probability


class Size(click.ParamType[int]):
    """A number of bytes, such as 500MB."""

    name = "SIZE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number."""
        from simbench.limits import parse_size

        try:
            return value if isinstance(value, int) else parse_size(value)
        except InputError as error:
            self.fail(str(error), param, ctx)


POSITIVE = click.FloatRange(min=0, min_open=True)
SEED = click.IntRange(0, 2**63 - 1)
OUT = click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out"), help="Where files go."
)


def _raise_limit(context: click.Context, _: click.Parameter, n_bytes: int | None) -> None:
    if n_bytes is not None:
        from simbench.limits import limited_to

        context.with_resource(limited_to(n_bytes))


LIMIT = click.option(
    "--limit",
    type=Size(),
    callback=_raise_limit,
    expose_value=False,
    help="What a file may claim of memory, default 2GB.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON value alone.")
DEBUG = click.option("--debug", is_flag=True, expose_value=False, help="Show tracebacks.")
SCENE = (
    click.option("--seed", type=SEED, help="Default: the scene's own."),
    click.option("--run", type=SEED, help="Run number, default 0."),
    click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a value."),
)
CONVENTION = (
    click.option("--imu-frame", type=click.Choice(["flu", "frd"]), help="Overrule what is found."),
    click.option(
        "--extrinsics",
        type=click.Choice(["imu_T_cam", "cam_T_imu", "mixed"]),
        help="Overrule what is found.",
    ),
    click.option(
        "--camera-axes",
        type=click.Choice(["optical", "regular"]),
        help="Overrule what is found; regular: x forward.",
    ),
)
TOLD = (
    *SCENE,
    *CONVENTION,
    click.option("--noise-pixel-px", type=POSITIVE, help="Sigma a filter is told, pixels."),
    click.option("--noise-velocity", type=POSITIVE, help="Sigma a filter is told, m/s."),
    click.option("--noise-angular", type=POSITIVE, help="Sigma a filter is told, rad/s."),
    click.option("--gate", type=Gate(), help="Chi-square gate, or none."),
)
PAST = (
    click.option("--smooth", is_flag=True, help="Past poses given all data, too."),
    click.option("--memory", type=Size(), help="What the backward pass may hold, default 1GB."),
    click.option(
        "--retire-after",
        type=click.IntRange(min=1),
        metavar="FRAMES",
        help="Feed the data as a stream: no last sighting is known.",
    ),
    click.option(
        "--landmarks",
        type=click.Choice(["cartesian", "inverse-depth"]),
        help="How they move, where a filter can; default cartesian, of a real drive inverse-depth.",
    ),
)


def options(*options: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a verb with options, in the order given."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed((*options, LIMIT, JSON, DEBUG)):
            function = option(function)
        return function

    return decorate


def open_dataset(path: Path, told: Mapping[str, Any]) -> "Dataset":
    """Open a source and say on standard error what its reader found."""
    from simbench.source import Told, open_source

    dataset = open_source(path, Told(**told))
    for note in dataset.notes:
        click.echo(note, err=True)
    return dataset
