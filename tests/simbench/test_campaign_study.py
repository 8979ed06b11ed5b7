"""What a study file means, and what is said of one that means nothing."""

import re
from pathlib import Path

import pytest

import simbench.campaign
from simbench.campaign import load
from simbench.errors import ScenarioError
from simbench.scenario import load as load_scenario
from tests.simbench.campaigns import STUDY

ROOT = Path(__file__).parents[2]


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.yaml").write_text("seed: 3\nduration_s: 2.0\n")

    def write(text):
        path = tmp_path / "gyro.yaml"
        path.write_text(text)
        return path

    return write


def points(plan):
    return [dict(case.overrides) for case in plan.cases]


def test_a_mapping_is_a_grid_of_all_combinations(write):
    plan = load(
        write(
            "scenarios: [room.yaml]\n"
            "sweep:\n"
            "  imu.velocity.sigma: [0.1, 0.2]\n"
            "  camera.sigma_px: [0.5, 1.0]\n"
        )
    )
    assert [tuple(point.values()) for point in points(plan)] == [
        (0.1, 0.5),
        (0.1, 1.0),
        (0.2, 0.5),
        (0.2, 1.0),
    ]
    assert [case.scenario.imu.velocity.sigma for case in plan.cases] == [0.1, 0.1, 0.2, 0.2]
    assert plan.study.name == "gyro"


def test_a_list_is_one_grid_after_another(write):
    plan = load(
        write(
            "scenarios: [room.yaml]\n"
            "sweep:\n"
            "  - {imu.velocity.sigma: 0.1, camera.sigma_px: 0.5}\n"
            "  - {imu.velocity.sigma: [[0.1, 0.2, 0.3]]}\n"
        )
    )
    assert points(plan) == [
        {"imu.velocity.sigma": 0.1, "camera.sigma_px": 0.5},
        {"imu.velocity.sigma": [0.1, 0.2, 0.3]},
    ]


def test_a_case_is_the_scenario_that_set_makes(write, tmp_path):
    (case,) = load(write("scenarios: [room.yaml]\nsweep: {camera.sigma_px: 0.3}")).cases
    alone = load_scenario(tmp_path / "room.yaml", ["camera.sigma_px=0.3"])
    assert case.scenario == alone
    assert case.fingerprint == alone.fingerprint()


def test_a_scenario_alone_is_a_study_of_it(write):
    options = {"runs": 7, "filters": ["slam", "slam-fej"]}
    plan = load(write("seed: 3\n").rename("room.yaml"), ["camera.sigma_px=0.3"], options)
    assert [case.scenario.name for case in plan.cases] == ["room"]
    assert (plan.study.runs, plan.study.filters) == (7, ("slam", "slam-fej"))
    assert points(plan) == [{"camera.sigma_px": 0.3}]
    assert plan.cases[0].seed == 3


def test_options_go_before_the_file(write):
    plan = load(write(STUDY), ["imu.velocity.sigma=0.4"], {"seed": 0})
    assert points(plan) == [{"imu.velocity.sigma": 0.4}]
    assert plan.cases[0].seed == 0


def test_a_plan_loads_back_from_its_own_text(write, tmp_path):
    plan = load(write("scenarios: [room.yaml]\nsweep: [{camera.sigma_px: [0.3, 0.4]}]"))
    (tmp_path / "elsewhere").mkdir()
    (whole := tmp_path / "elsewhere" / "study.yaml").write_text(plan.to_yaml())
    assert load(whole) == plan


def test_the_study_in_the_readme_is_one(write):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^```yaml\n(scenarios:.*?)^```", text, re.MULTILINE | re.DOTALL)
    path = write(shown)
    for name in ("figure8.yaml", "helix.yaml"):
        path.with_name(name).symlink_to(ROOT / "scenarios" / name)
    assert len(load(path).cases) == 2 * 2 * 2


def test_the_study_in_the_docstring_is_one(write):
    (shown,) = re.findall(r"```yaml\n(.*?)```", str(simbench.campaign.__doc__), re.DOTALL)
    path = write(shown)
    path.with_name("figure8.yaml").symlink_to(ROOT / "scenarios" / "figure8.yaml")
    plan = load(path)
    assert len(plan.cases) == 2
    assert plan.study.outputs == ("parquet", "series")
    assert plan.study.smooth


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("runs: 3", "gyro.yaml:1: scenarios: expected a list of at least 1, got 0"),
        ("scenarios: [no.yaml]", "no.yaml: "),
        (
            "scenarios: [room.yaml]\nfilters: [slam,\n  slamm]",
            "gyro.yaml:2: filters: --filter slamm: expected a filter's name or "
            "package.module:factory. Did you mean slam?",
        ),
        (
            "scenarios: [room.yaml]\nfilters: [slam, slam]",
            "gyro.yaml:2: filters: expected each name once, got slam twice",
        ),
        (
            "scenarios: [room.yaml]\nchecks: [exact-audits]",
            "gyro.yaml:2: checks: Expected the name of a check, got 'exact-audits'. "
            "Did you mean exact-audit?",
        ),
        (
            "scenarios: [room.yaml]\nrun: 3",
            "gyro.yaml:2: run: unknown key; did you mean runs?",
        ),
        (
            "scenarios: [room.yaml]\nsweep:\n  camera.dropout: 0.1\n  imu.velocity.sgma: 0.1",
            "gyro.yaml:4: imu.velocity.sgma: unknown key; did you mean sigma?",
        ),
        (
            "scenarios: [room.yaml]\nsweep:\n  - {camera.sigma_px: 0.1}\n  - {seed.x: 1}",
            "gyro.yaml:4: seed.x: expected a section above it, but seed is 3",
        ),
        (
            "scenarios: [room.yaml]\nsweep: {camera.sigma_px: [0.1, -1]}",
            "gyro.yaml:2: camera.sigma_px: expected a number above 0, got -1",
        ),
        (
            "scenarios: [room.yaml]\nsweep: {camera.sigma_px: []}",
            "gyro.yaml:2: sweep.camera.sigma_px: expected a value or a list of them, got none",
        ),
        (
            "scenarios: [room.yaml]\nsweep: 3",
            "gyro.yaml:2: sweep: expected a mapping of keys to values, or a list of such, got 3",
        ),
        (
            "scenarios: [room.yaml]\nsweep: {camera.sigma_px: [0.3, 0.3]}",
            "expected scenes that differ, got room with {'camera.sigma_px': 0.3} and with",
        ),
        (
            "scenarios:\n  - rate_hz: 0\nruns: 2",
            "gyro.yaml:2: rate_hz: expected a number above 0, got 0",
        ),
        (
            "scenarios: [room.yaml]\nsmooth: 1",
            "gyro.yaml:2: smooth: expected true or false, got 1",
        ),
        ("scenarios: [room.yaml]\noutputs: [hdf5]", "gyro.yaml:2: outputs[0]: expected 'parquet'"),
        ("[1, 2]", "gyro.yaml:1: expected a mapping of sections, got [1, 2]"),
    ],
)
def test_a_fault_is_said_with_its_place(write, text, said):
    with pytest.raises(ScenarioError) as error:
        load(write(text))
    assert said in str(error.value)


def test_all_faults_are_said_at_once(write):
    with pytest.raises(ScenarioError) as error:
        load(write("scenarios: [room.yaml]\nruns: 0\nfilters: []"), ["x"], {"seed": -1})
    assert [fault.where.rpartition("/")[2] for fault in error.value.faults] == [
        "--set x",
        "gyro.yaml:3",
        "gyro.yaml:2",
        "--seed",
    ]
