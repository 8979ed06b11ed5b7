"""The conformance suite of a filter as tests of pytest.

``pytest --simbench-filter package.module:factory`` (it may be repeated), or in the ini file

```ini
[pytest]
simbench_filters =
    package.module:factory
```

adds a test for each check of `simbench.checks.conformance`, and one for each scene of the audit; a
summary says how many ran. What fails as a property of the method, coded rightly, counts as an
expected failure; what does not apply is skipped. Select them with ``-k simbench``.
"""

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from simbench.checks.result import CheckResult
    from vislam.filters import Factory

OPTION, INI, JUDGED = "--simbench-filter", "simbench_filters", "simbench_filter"


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option and the ini key."""
    parser.getgroup("simbench").addoption(
        OPTION,
        action="append",
        default=[],
        metavar="FILTER",
        help="run simbench's conformance suite on a filter's name or package.module:factory",
    )
    parser.addini(INI, "filters to run simbench's conformance suite on", type="linelist")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Add the suite of each filter, before anything is deselected."""
    names = [*config.getini(INI), *config.getoption(OPTION)]
    for name in dict.fromkeys(names):
        items += Suite.from_parent(session, name=name, nodeid=f"simbench::{name}").collect()


class ConformanceFailure(Exception):
    """A filter that does not satisfy a check; the message is the reason."""


class Suite(pytest.Collector):
    """All checks of a filter."""

    def collect(self) -> list[pytest.Item]:
        """An item for each check, the audit's by scene.

        Raises:
            pytest.UsageError: there is no such filter.
        """
        from simbench.errors import InputError
        from simbench.filters import resolve

        try:
            factory = resolve(self.name)
        except InputError as error:
            raise pytest.UsageError(str(error)) from error
        return [
            CheckItem.from_parent(
                self,
                name=f"{check}[{scene}]" if scene else check,
                check=check,
                scene=scene,
                factory=factory,
            )
            for check, scene in _checks()
        ]


def _checks() -> Iterator[tuple[str, str | None]]:
    """Checks by name, with the scene where they are run on several."""
    from simbench.checks.conformance import CHECKS
    from simbench.checks.scenes import SCENES

    for check in CHECKS:
        if check == "exact-audit":
            yield from ((check, scene) for scene in SCENES)
        else:
            yield check, None


class CheckItem(pytest.Item):
    """One check of a filter."""

    def __init__(self, *, check: str, scene: str | None, factory: "Factory", **node: Any) -> None:
        """Keep what is to be checked; `node` is pytest's."""
        super().__init__(**node)
        self._check, self._scene, self._factory = check, scene, factory
        assert self.parent is not None
        self.user_properties.append((JUDGED, self.parent.name))

    def runtest(self) -> None:
        """Run the check."""
        result = self._result()
        if result.outcome == "skipped":
            pytest.skip(result.reason)
        if result.failed and result.failure == "property of the method":
            pytest.xfail(f"{result.failure}: {result.reason}")
        if result.failed:
            raise ConformanceFailure(result.reason)

    def _result(self) -> "CheckResult":
        from simbench.checks.conformance import resolve
        from simbench.checks.scenes import drive

        return resolve(self._check)(self._factory, drive(self._scene) if self._scene else None)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """The reason alone, where a check found something."""
        if isinstance(excinfo.value, ConformanceFailure):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Any, None, str]:
        """The title of a failure."""
        return self.path, None, self.nodeid


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say for each filter how many checks ran, and what came of them."""
    outcomes: dict[str, Counter[str]] = {}
    for outcome in ("passed", "failed", "xfailed", "skipped"):
        for report in terminalreporter.getreports(outcome):
            for key, name in getattr(report, "user_properties", ()):
                if key == JUDGED:
                    outcomes.setdefault(name, Counter())[outcome] += 1
    if outcomes:
        terminalreporter.section("simbench")
    for name, count in outcomes.items():
        ran = count.total() - count["skipped"]
        terminalreporter.line(
            f"{name}: {ran} checks ran: {count['passed']} passed, {count['failed']} failed, "
            f"{count['xfailed']} failed as a property of the method; "
            f"{count['skipped']} do not apply"
        )
