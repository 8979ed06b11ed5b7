"""All instruments together name the mistake, or the scene, or find none."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from simbench.checks import instruments
from simbench.checks.conformance import CHECKS
from simbench.checks.instruments import check, untold
from simbench.cli import main
from simbench.scenario import load
from tests.simbench.test_chance import failed
from tests.simbench.test_montecarlo import SHORT, Raising, short
from vislam.filters import EkfSlam, Parts

SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.fixture
def two_laws(monkeypatch):
    """The laws have tests of their own; two of them are enough to see what becomes of them."""
    monkeypatch.setattr(
        instruments, "CHECKS", {name: CHECKS[name] for name in ("null-space", "run-twice")}
    )


@pytest.mark.usefixtures("two_laws")
def test_a_rightly_coded_filter_may_be_inconsistent_and_the_verdict_says_so():
    """The paper's filter with an unsure heading; the transported one is consistent there."""
    scene = load(SCENARIOS / "heading.yaml")
    paper = check(scene, "slam", runs=8, jobs=1)
    assert not paper.passed
    assert not {name for name in failed(paper) if name.startswith("exact-audit")}
    assert {name for name in failed(paper) if name.startswith("pose NEES")}
    assert paper.conclusion.startswith("Correct code, inconsistent method in this scene")
    assert "null-space: property of the method" in paper.conclusion
    assert "outside the linear regime" in paper.conclusion
    transported = check(scene, "slam-transport", runs=8, jobs=1)
    assert transported.passed
    assert transported.conclusion.startswith("No mistake was found")


def no_transition(T, T_next):  # noqa: ARG001
    return np.eye(6)


@pytest.mark.usefixtures("two_laws")
def test_a_mistake_in_the_code_is_named_by_the_audit():
    wrong = partial(EkfSlam, parts=Parts(transition=no_transition))
    verdict = check(short(), wrong, runs=2, jobs=1)
    assert "exact-audit" in failed(verdict)
    assert verdict.conclusion.startswith("A mistake in the code. exact-audit: ")
    assert "predict 0" in verdict.conclusion


@pytest.mark.usefixtures("two_laws")
def test_a_scene_that_does_not_tell_the_truth_is_blamed_for_it():
    scene = short("told.baseline_scale=1.2", "filter.gate=none")
    assert untold(scene) == ("told.baseline_scale",)
    verdict = check(scene, "slam-transport", runs=5, jobs=1)
    assert not verdict.passed
    assert "does not tell it the truth (told.baseline_scale)" in verdict.conclusion


@pytest.mark.parametrize(
    "override",
    [
        "imu.velocity.bias_sigma=0.1",
        "imu.angular_velocity.bias_walk=[0, 0, 0.1]",
        "imu.twist=instantaneous",
        "camera.outliers.share=0.1",
        "told.rotation_error_deg=[0, 0, 1]",
    ],
)
def test_every_way_not_to_tell_the_truth_is_known(override):
    assert untold(short()) == ()
    (key,) = untold(short(override))
    assert override.startswith(key)


@pytest.mark.usefixtures("two_laws")
def test_check_answers_in_json_and_by_its_exit_status(tmp_path, capsys):
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    options = ["--runs", "3", "--jobs", "1", "--json"]
    assert main(["check", str(path), "--filter", "slam-transport", *options]) == 0
    value = json.loads(capsys.readouterr().out)
    assert value["passed"]
    assert value["false_alarm"] == 0.01
    assert value["runs"] == 3
    keys = {"name", "passed", "statistic", "low", "high", "p", "reason"}
    assert all(set(line) == keys for line in value["checks"])

    raising = f"{Raising.__module__}:Raising"
    assert main(["check", str(path), "--filter", raising, *options]) == 1
    value = json.loads(capsys.readouterr().out)
    assert not value["passed"]
    (line,) = [each for each in value["checks"] if each["name"] == "runs that raised"]
    assert line["statistic"] == 3
    assert "predict 2 raised RuntimeError: lost" in line["reason"]
    assert main(["check", str(tmp_path / "none.yaml"), "--filter", "slam"]) == 2
    assert main(["check", str(path), "--filter", "slam", "--false-alarm", "1.5"]) == 2
