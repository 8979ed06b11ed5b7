"""A campaign gives the rows that each run alone would, whatever becomes of the way there."""

import csv
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from simbench.campaign import campaign, code, load
from simbench.campaign.children import perform
from simbench.campaign.engine import TASK_S, _Unfinished
from simbench.campaign.journal import Journal
from simbench.campaign.results import read
from simbench.campaign.rows import COLUMNS, METRICS, SERIES, WALL, Runs
from simbench.cli import main
from simbench.errors import InputError, OutputError
from simbench.filters import resolve
from simbench.limits import limit_bytes, limited_to
from simbench.metrics import ate, metrics, nis, pose_nees
from simbench.run import RunOptions, run
from simbench.scenario import load as load_scenario
from simbench.sensors import simulate
from tests.simbench.campaigns import FILTERS, STUDY, table

SIMBENCH = [sys.executable, "-c", "import sys; from simbench.cli import main; sys.exit(main())"]


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A study file in the working directory, beside the module `endings`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "endings", raising=False)
    (tmp_path / "endings.py").write_text(FILTERS)
    (path := tmp_path / "small.yaml").write_text(STUDY)
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The small study with everything it can write."""
    out = tmp_path_factory.mktemp("campaign")
    (path := out / "small.yaml").write_text(STUDY + "outputs: [parquet, series]\n")
    plan = load(path)
    return plan, out / "out", campaign(plan, out / "out", jobs=2)


def alone(out, row):
    """The run of a row, made again by what the row says, in this process."""
    scenario = load_scenario(out / "scenes" / f"{row['case']}.yaml")
    data = simulate(scenario, int(row["seed"]), int(row["run"]))
    return run(data, resolve(row["filter"]), name=row["filter"])


def test_a_row_is_to_the_last_bit_what_it_says_how_to_make_again(done):
    _, out, _ = done
    rows = table(out)
    assert len(rows) == 2 * 3 * 2
    for row in rows:
        record = alone(out, row)
        known = metrics(record)
        assert {name: row[name] for name in METRICS} == {
            name: "" if known[name] is None else repr(known[name]) for name in METRICS
        }
        assert row["status"] == "done"
        assert row["code"] == code.packages()
        assert row["pose_nees_end"] == repr(float(pose_nees(record)[-1]))
        assert row["nis"] == (
            "" if row["filter"] == "dead-reckoning" else repr(nis(record)[0].sum().item())
        )


def test_the_columns_are_all_numbers_of_the_metrics(done):
    _, out, _ = done
    known = metrics(alone(out, table(out)[0]))
    words = {"source", "filter", "noise_fit"}
    assert {*METRICS, *WALL.values()} == set(known) - words


def test_rows_stand_in_the_order_of_the_study(done):
    _, out, _ = done
    order = [
        (json.loads(r["overrides"])["imu.velocity.sigma"], r["run"], r["filter"])
        for r in table(out)
    ]
    assert order == [
        (sigma, run, name)
        for sigma in (0.1, 0.2)
        for run in "012"
        for name in ("slam", "dead-reckoning")
    ]


def test_rows_do_not_depend_on_the_number_of_processes_or_on_the_company(done, tmp_path):
    plan, out, _ = done
    campaign(plan, tmp_path / "one", jobs=1)
    assert table(tmp_path / "one") == table(out)
    lonely = replace(
        plan,
        study=plan.study.model_copy(update={"filters": ("dead-reckoning",), "outputs": ()}),
        cases=plan.cases[1:],
    )
    campaign(lonely, tmp_path / "lonely", jobs=1)
    expected = [r for r in table(out)[6:] if r["filter"] == "dead-reckoning"]
    assert table(tmp_path / "lonely") == expected


def test_parquet_holds_what_the_csv_does(done):
    _, out, _ = done
    assert list(read(out / "results.parquet")) == list(read(out))


def test_series_are_those_of_the_run(done):
    _, out, _ = done
    with (out / "series.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    first = table(out)[0]
    record = alone(out, first)
    of_first = [
        line for line in lines if all(line[k] == first[k] for k in ("case", "filter", "run"))
    ]
    position = ate(record.T_world_imu, record.dataset.truth.T_world_imu).translation_m
    assert [line["frame"] for line in of_first] == [str(i) for i in range(11)]
    assert [float(line["position_error_m"]) for line in of_first] == position.tolist()
    assert [float(line["pose_nees"]) for line in of_first] == pose_nees(record).tolist()
    assert len(lines) == 11 * 12
    assert set(SERIES) < set(lines[0])


def test_a_filter_that_ends_badly_costs_nobody_else(study):
    names = ("hangs", "hangs_and_lets_nobody_else_run", "crashes", "exits", "raises")
    filters = ["slam", *(f"endings:{name}" for name in names)]
    options = {"filters": filters, "time_limit_s": 2.0, "runs": 2}
    campaign(load(study, ["imu.velocity.sigma=0.1"], options), Path("out"), jobs=2)
    rows = table(Path("out"))
    right = {row["run"]: row for row in rows if row["filter"] == "slam"}
    ended = {(row["filter"][8:], row["run"]): row for row in rows if row["filter"] != "slam"}
    assert len(ended) == 5 * 2
    bad = {run for name, run in ended if ended[name, run]["status"] != "done"}
    assert bad
    assert bad < set(right)
    said = {
        "hangs": ("hung", "no answer within 2 s; it was in <lambda>,"),
        "hangs_and_lets_nobody_else_run": ("hung", "no answer within 2 s; it was in <lambda>,"),
        "crashes": ("failed", "its process ended with SIGSEGV; it was in string_at,"),
        "exits": ("failed", "its process ended with exit status 3"),
        "raises": ("failed", "predict 2 raised ZeroDivisionError"),
    }
    for (name, number), row in ended.items():
        if number in bad:
            assert row["status"] == said[name][0]
            assert row["reason"].startswith(said[name][1])
            assert row["ate_rmse_m"] == ""
        else:
            assert row["ate_rmse_m"] == right[number]["ate_rmse_m"]


def test_a_scene_that_cannot_be_simulated_is_a_row_for_each_filter(study):
    plan = load(study, ["imu.velocity.sigma=0.1", "landmarks.center_m=[-9,0,0]"], {"runs": 1})
    summary = campaign(plan, Path("out"), jobs=1)
    assert [row["status"] for row in table(Path("out"))] == ["failed", "failed"]
    failure = summary["groups"][0]["failure"]
    assert "no landmark is ever seen" in failure.pop("reason")
    assert failure == {"seed": 5, "run": 0, "status": "failed"}


def test_finished_rows_are_not_made_again(study):
    options = {"filters": ["endings:counted"], "runs": 4}
    plan, out = load(study, (), options), Path("out")
    campaign(plan, out, jobs=1)
    whole, journal = table(out), out / "journal.jsonl"
    assert Path("counted").read_text().count("run") == 8
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:3], *lines[4:6]]) + lines[6][:50])
    campaign(plan, out, jobs=1)
    assert Path("counted").read_text().count("run") == 8 + 3
    assert table(out) == whole
    campaign(load(study, (), options | {"runs": 5}), out, jobs=1)
    assert Path("counted").read_text().count("run") == 8 + 3 + 2
    assert [row for row in table(out) if row["run"] != "4"] == whole


def test_rows_of_other_code_are_made_again(study, monkeypatch):
    plan = load(study, ["imu.velocity.sigma=0.1"], {"filters": ["endings:counted"], "runs": 2})
    campaign(plan, Path("out"), jobs=1)
    before = table(Path("out"))
    study.with_name("endings.py").write_text(FILTERS + "# another\n")
    monkeypatch.delitem(sys.modules, "endings")
    campaign(plan, Path("out"), jobs=1)
    assert Path("counted").read_text().count("run") == 4
    assert {row["code"] for row in table(Path("out"))}.isdisjoint(row["code"] for row in before)


def test_a_worker_with_other_code_is_refused(study):
    plan = load(study)
    case = plan.cases[0]
    task = Runs(
        todo=((0, "slam"),),
        time_limit_s=9.0,
        code="0" * 12,
        case=0,
        scenario=case.scenario,
        seed=5,
        smooth=False,
        series=False,
        limit_bytes=limit_bytes(),
    )
    with pytest.raises(InputError, match="install the same version there"):
        perform(task)


def test_an_interrupted_campaign_leaves_no_process_and_goes_on(study):
    arguments = ["campaign", study.name, "--filter", "endings:counted", "--runs", "10"]
    process = subprocess.Popen(
        [*SIMBENCH, *arguments], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    journal = Path("out/journal.jsonl")
    while not (journal.exists() and journal.read_bytes().count(b"\n") > 3):
        assert process.poll() is None
        time.sleep(0.05)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Interrupted; finished rows are in out; the same command goes on." in err
    assert "Traceback" not in err
    assert not out
    assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]
    finished = journal.read_bytes().count(b"\n")
    assert 3 < finished < 20
    made = Path("counted").read_text().count("run")
    assert main(arguments) == 0
    assert len(table(Path("out"))) == 20
    assert Path("counted").read_text().count("run") == made + 20 - finished


def test_a_file_that_is_no_journal_is_left_alone(study):
    Path("out").mkdir()
    Path("out/journal.jsonl").write_text('{"mine": 1}\n')
    with pytest.raises(InputError, match=r"journal.jsonl:1: expected a row of"):
        campaign(load(study), Path("out"))
    assert Path("out/journal.jsonl").read_text() == '{"mine": 1}\n'


@pytest.mark.parametrize(("row_s", "runs"), [(0.1, 10), (30.0, 1), (1e-9, 125)])
def test_a_task_takes_its_time_and_leaves_enough_tasks(study, row_s, runs):
    plan = load(study, ["imu.velocity.sigma=0.1"], {"runs": 1000})
    work = _Unfinished(plan)
    with Journal(Path("journal"), work.heads, 1000) as journal:
        tasks = work.runs(journal, workers=2)
        assert len(next(tasks).todo) == 2
        work.seconds[0] = row_s
        todo = next(tasks).todo
    assert todo[0] == (1, "slam")
    assert len(todo) == 2 * runs
    assert runs == 125 or len(todo) * row_s == pytest.approx(max(TASK_S, 2 * row_s))


def test_a_second_campaign_in_one_directory_is_refused_and_harms_nothing(study):
    out = Path("out")

    def second(_done, _of):
        before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
        with pytest.raises(OutputError, match=r"journal.jsonl: another campaign is writing it"):
            campaign(load(study, (), {"runs": 2}), out, jobs=1)
        assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before

    campaign(load(study, (), {"runs": 1}), out, jobs=1, on_progress=second)
    assert len(table(out)) == 2 * 2


def test_the_limit_reaches_the_processes_that_simulate(study):
    plan = load(study, ["imu.velocity.sigma=0.1"], {"runs": 1})
    with limited_to(1000):
        campaign(plan, Path("low"), jobs=1)
    assert {row["status"] for row in table(Path("low"))} == {"failed"}
    assert all("above the limit of 1000 B" in row["reason"] for row in table(Path("low")))
    campaign(plan, Path("low"), jobs=1)
    assert {row["status"] for row in table(Path("low"))} == {"done"}


def test_the_processes_find_modules_where_the_campaign_does(study, tmp_path_factory, monkeypatch):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "far_away.py").write_text("from vislam.filters import EkfSlam as Slam\n")
    monkeypatch.syspath_prepend(elsewhere)
    campaign(load(study, (), {"filters": ["far_away:Slam"], "runs": 1}), Path("out"), jobs=1)
    assert {row["status"] for row in table(Path("out"))} == {"done"}


def test_a_study_that_smooths_has_the_numbers_of_the_smoothed_poses(study):
    set_ = ["imu.velocity.sigma=0.1"]
    campaign(load(study, set_, {"runs": 2}), out := Path("out"), jobs=1)
    filtered = table(out)
    assert {row["smoothed_ate_rmse_m"] for row in filtered} == {""}
    study.write_text(STUDY + "smooth: true\n")
    summary = campaign(load(study, set_, {"runs": 2}), out, jobs=1)
    smoothed = [name for name in COLUMNS if name.startswith("smoothed_")]
    for before, row in zip(filtered, table(out), strict=True):
        data = simulate(load_scenario(out / "scenes" / f"{row['case']}.yaml"), 5, int(row["run"]))
        known = metrics(run(data, resolve(row["filter"]), options=RunOptions(smooth=True)))
        expected = {name: "" if known[name] is None else repr(known[name]) for name in METRICS}
        assert row == before | expected
    slam, dead_reckoning = summary["groups"]
    assert all(slam["metrics"][name]["n"] == 2 for name in smoothed)
    assert all(dead_reckoning["metrics"][name] is None for name in smoothed)


def test_checks_of_a_study_are_made_once_for_each_filter(study, capfd):
    bug = "slam+adjoint-of-wrong-sign"
    study.write_text(STUDY.replace("dead-reckoning", bug) + "checks: [exact-audit, run-twice]\n")
    assert main(["campaign", study.name, "--runs", "1", "--jobs", "1", "--json"]) == 1
    printed = json.loads(capfd.readouterr().out)
    assert [(c["filter"], c["name"], c["outcome"]) for c in printed["checks"]] == [
        ("slam", "exact-audit", "passed"),
        ("slam", "run-twice", "passed"),
        (bug, "exact-audit", "failed"),
        (bug, "run-twice", "passed"),
    ]
    assert json.loads(Path("out/summary.json").read_text()) == printed


def test_what_a_filter_prints_is_not_among_the_results(study, capfd):
    arguments = ["--filter", "endings:counted", "--runs", "1", "--jobs", "1", "--json"]
    assert main(["campaign", study.name, *arguments]) == 0
    said = capfd.readouterr()
    assert json.loads(said.out)["filters"] == ["endings:counted"]
    assert said.err.splitlines() == ["a filter may print"] * 2
    with Path("out/results.csv").open() as file:
        assert file.readline() == ",".join(COLUMNS) + "\n"
