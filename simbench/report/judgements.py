"""Sections on audits and verdicts."""

from collections.abc import Iterator
from pathlib import Path

from simbench import figures
from simbench.checks.conformance import CHECKS
from simbench.report import meaning
from simbench.report.meaning import command, commands, show_law, show_run
from simbench.report.page import Block, Cell, Finding, Picture, Section, Tone, table
from simbench.report.saved import (
    HowMade,
    SavedAudit,
    SavedCheck,
    SavedVerdict,
)


def audit(saved: SavedAudit) -> Section:
    """The section on an audit."""
    scalars = sum(scene.scalars for scene in saved.scenes)
    verdict = (
        f"No deviation in {scalars} scalars of noise: the covariance that is claimed is that of "
        "the errors, to first order, after every call."
        if saved.passed or saved.first is None
        else f"A mistake in the code. First at {meaning.finding_text(saved.first)}."
    )
    return Section(
        kind="exact audit",
        title=saved.filter,
        passed=saved.passed,
        verdict=verdict,
        again=(_audit_again(saved),),
        facts=_facts(saved),
        findings=tuple(_audit_findings(saved)),
        blocks=tuple(_audit_blocks(saved)),
    )


def _audit_findings(saved: SavedAudit) -> Iterator[Finding]:
    """The scenes where it failed, those for the same reason together."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for scene in saved.scenes:
        if scene.first is not None:
            found = meaning.finding_text(scene.first)
            groups.setdefault(meaning.of_audit(scene.first), []).append((scene.name, found))
    show = show_run(saved, saved.run or 0) or command("hunt", "--filter", saved.filter)
    for means, scenes in groups.items():
        names = tuple(name for name, _ in scenes)
        yield Finding(names=names, found=scenes[0][1], means=means, commands=(show,))


def _audit_blocks(saved: SavedAudit) -> Iterator[Block]:
    yield table(
        "Scenes",
        ("scene", "outcome", "scalars of noise", "power of eps", "10 % at, times the noise"),
        [
            (s.name, _outcome(s.passed), s.scalars, s.order, s.noise_at_ten_percent)
            for s in saved.scenes
        ],
    )
    names = dict.fromkeys(name for by_name in saved.deviations.values() for name in by_name)
    by_name = {
        name: {float(eps): of.get(name) or 0.0 for eps, of in saved.deviations.items()}
        for name in names
    }
    if any(any(of.values()) for of in by_name.values()):
        yield Picture(
            figure=figures.decay(by_name),
            caption="What is wrong in the code stays when the noise shrinks; what is only not "
            "linear falls with its square. The blocks of the covariance are the judge.",
        )
    if saved.deviations:
        yield table(
            "Deviations, the worst of all scenes",
            ("eps", *names),
            [(float(eps), *(of.get(n) for n in names)) for eps, of in saved.deviations.items()],
            folded=True,
        )


def verdict(saved: SavedVerdict) -> Section:
    """The section on a verdict."""
    return Section(
        kind="verdict",
        title=f"{saved.filter} in {Path(saved.scenario).stem}" if saved.scenario else saved.filter,
        passed=saved.passed,
        verdict=saved.conclusion,
        again=(_verdict_again(saved),),
        facts=_facts(saved)
        | {"runs": str(saved.runs), "false alarms": f"{100 * saved.false_alarm:g} % at the most"},
        findings=tuple(_verdict_findings(saved)),
        blocks=tuple(_verdict_blocks(saved)),
    )


def _verdict_findings(saved: SavedVerdict) -> Iterator[Finding]:
    """What failed, that with the same reason together; then properties of the method."""
    groups: dict[str, list[SavedCheck]] = {}
    for check in saved.checks:
        if not check.passed:
            groups.setdefault(check.reason, []).append(check)
    for reason, checks in groups.items():
        exact = all(check.p is None for check in checks) and checks[0].name != "runs that raised"
        yield Finding(
            names=tuple(check.name for check in checks),
            found=reason if exact or checks[0].name == "runs that raised" else "",
            means=_means(checks[0].name) if exact else reason,
            commands=commands(_show(checks[0].name, saved)),
        )


def _means(name: str) -> str:
    if name in CHECKS and name != "exact-audit":
        return meaning.of_law(name)
    return (
        "The covariance that is claimed is not that of the errors; the first call and block say "
        "where the code is wrong."
    )


def _show(name: str, saved: SavedVerdict) -> str | None:
    if name == "exact-audit":
        return command("audit", "--filter", saved.filter)
    if name in CHECKS:
        return show_law(name, saved.filter)
    if name.startswith("exact-audit") and saved.scenario is not None:
        seed = [] if saved.seed is None else ["--seed", str(saved.seed)]
        scene = ["--scene", saved.scenario, *seed, *_sets(saved)]
        return command("audit", "--filter", saved.filter, *scene)
    return show_run(saved, saved.look_at or 0)


def _verdict_blocks(saved: SavedVerdict) -> Iterator[Block]:
    bands = {
        check.name: (check.low, check.statistic, check.high)
        for check in saved.checks
        if check.p is not None
        and check.low is not None
        and check.statistic is not None
        and check.high is not None
    }
    if bands:
        yield Picture(
            figure=figures.within_bands(bands),
            caption="The checks by chance. A right filter lies within the band in all of them at "
            f"once, but for {100 * saved.false_alarm:g} % of such verdicts.",
        )
    by_chance = [check for check in saved.checks if check.p is not None]
    exact = [check for check in saved.checks if check.p is None]
    yield table(
        "By chance",
        ("check", "outcome", "statistic", "low", "high", "p, corrected"),
        [(c.name, _checked(c), c.statistic, c.low, c.high, c.p) for c in by_chance],
    )
    yield table(
        "Without chance",
        ("check", "outcome", "statistic", "at the most"),
        [(c.name, _checked(c), c.statistic, c.high) for c in exact],
    )
    if notes := [(c.name, c.reason) for c in exact if c.passed and c.reason]:
        yield table("Noted, not judged", ("check", "what it found"), notes)
    if saved.figures:
        yield table(
            "Accuracy, median over the runs, not judged",
            ("what", "value"),
            list(saved.figures.items()),
        )
    if saved.skipped:
        rows = list(saved.skipped.items())
        yield table("Skipped", ("check", "why"), rows, folded=True)


def _outcome(passed: bool) -> Cell:
    tone: Tone = "good" if passed else "bad"
    return Cell(text="passed" if passed else "failed", key=float(passed), tone=tone)


def _checked(check: SavedCheck) -> Cell:
    if check.passed and check.reason:
        return Cell(text="note", key=0.5, tone="note")
    return _outcome(check.passed)


def _facts(made: HowMade) -> dict[str, str]:
    facts = {"filter": made.filter, "scene": made.scenario or "built-in"}
    if made.seed is not None:
        facts["seed"] = str(made.seed)
    if made.run is not None:
        facts["run"] = str(made.run)
    if made.overrides:
        facts["changed"] = ", ".join(made.overrides)
    return facts


def _audit_again(saved: SavedAudit) -> str:
    words = ["audit", "--filter", saved.filter]
    if saved.scenario is not None:
        words += ["--scene", saved.scenario]
        for option, value in (
            ("--most-scalars", saved.most_scalars),
            ("--seed", saved.seed),
            ("--run", saved.run),
        ):
            words += [] if value is None else [option, str(value)]
    return command(*words, *_sets(saved))


def _verdict_again(saved: SavedVerdict) -> str:
    seed = [] if saved.seed is None else ["--seed", str(saved.seed)]
    rates = ["--runs", str(saved.runs), "--false-alarm", f"{saved.false_alarm:g}"]
    scene = saved.scenario or "SCENARIO.yaml"
    return command("check", scene, "--filter", saved.filter, *rates, *seed, *_sets(saved))


def _sets(made: HowMade) -> list[str]:
    return [word for override in made.overrides for word in ("--set", override)]
