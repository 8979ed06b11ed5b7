"""The statistics of a comparison against other people's, and the tables that show them."""

import csv
import json

import numpy as np
import pytest
import scipy.stats

from simbench.campaign import summary as summaries
from simbench.campaign.rows import COLUMNS
from simbench.campaign.summary import holm, summarise
from simbench.cli import main
from simbench.compare import FORMATS, compare, tables
from simbench.errors import DatasetError, InputError
from simbench.filters import resolve
from simbench.metrics import metrics
from simbench.run import run
from simbench.sensors import simulate
from tests.simbench.scenes import scene

RUNS = 40


def row(name, number, **values):
    head = {"scenario": "room", "overrides": '{"a.b": 1}', "case": "0123456789ab", "filter": name}
    tail = {"seed": 3, "run": number, "code": "c", "status": "done", "reason": ""}
    return dict.fromkeys(COLUMNS) | head | tail | values


def rows(runs=RUNS):
    """Two filters, the second a little worse; it fails in run 3, and has diverged in run 4."""
    rng = np.random.default_rng(5)
    for number in range(runs):
        ate, worse = rng.gamma(4.0, 0.1), rng.normal(0.05, 0.1)
        nees, nis = rng.chisquare(6, 2), rng.chisquare(200, 2)
        for k, (name, error) in enumerate({"good": ate, "bad": ate + worse}.items()):
            if (name, number) == ("bad", 3):
                yield row(name, number, status="failed", reason="update 2 raised")
                continue
            yield row(
                name,
                number,
                ate_rmse_m=float(error),
                wall_s=0.1,
                nis=float(nis[k]),
                nis_dof=200,
                diverged=int((name, number) == ("bad", 4)),
                pose_nees_end=None if (name, number) == ("bad", 4) else float(nees[k]),
            )


def column(name, key):
    return np.array([r[key] for r in rows() if r["filter"] == name], float)


@pytest.fixture(scope="module")
def summary():
    return summarise([("", rows())])


def group(summary, name):
    (found,) = [g for g in summary["groups"] if g["filter"] == name]
    return found


def test_a_mean_has_students_interval(summary):
    x = column("good", "ate_rmse_m")
    found = group(summary, "good")["metrics"]["ate_rmse_m"]
    low, high = scipy.stats.t.interval(0.95, RUNS - 1, x.mean(), scipy.stats.sem(x))
    expected = {"n": RUNS, "mean": x.mean(), "low": low, "high": high}
    assert found == pytest.approx(expected | {"std": x.std(ddof=1), "median": np.median(x)})


def test_rows_that_failed_are_counted_and_take_no_part_in_the_means(summary):
    bad, x = group(summary, "bad"), column("bad", "ate_rmse_m")
    assert (bad["runs"], bad["done"], bad["failed"], bad["hung"]) == (RUNS, RUNS - 1, 1, 0)
    assert bad["failure"] == {"seed": 3, "run": 3, "status": "failed", "reason": "update 2 raised"}
    assert bad["metrics"]["ate_rmse_m"]["mean"] == pytest.approx(np.nanmean(x))
    assert bad["metrics"]["ate_rmse_m"]["median"] == pytest.approx(np.nanmedian(x))
    assert bad["metrics"]["landmark_rmse_m"] is None


def test_the_share_of_diverged_runs_has_an_exact_interval(summary):
    found = group(summary, "bad")["diverged"]
    exact = scipy.stats.binomtest(1, RUNS - 1).proportion_ci(0.95, method="exact")
    expected = {"count": 1, "of": RUNS - 1, "share": 1 / (RUNS - 1)}
    assert found == pytest.approx(expected | {"low": exact.low, "high": exact.high})


def test_nees_and_nis_stand_against_two_sided_bands(summary):
    good = group(summary, "good")
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 6 * RUNS) / (6 * RUNS)
    value = column("good", "pose_nees_end").mean() / 6
    inside = bool(low < value < high)
    expected = {"value": value, "low": low, "high": high, "dof": 6 * RUNS, "inside": inside}
    assert good["nees"] == pytest.approx(expected)
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 200 * RUNS) / (200 * RUNS)
    assert good["nis"]["value"] == pytest.approx(column("good", "nis").sum() / (200 * RUNS))
    assert (good["nis"]["low"], good["nis"]["high"]) == pytest.approx((low, high))


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_nees_is_outside_its_band_on_either_side(scale):
    scaled = (
        r | {"pose_nees_end": r["pose_nees_end"] * scale} for r in rows() if r["filter"] == "good"
    )
    (found,) = summarise([("", scaled)])["groups"]
    assert not found["nees"]["inside"]


def test_a_run_of_infinite_nees_puts_the_mean_outside(summary):
    found = group(summary, "bad")["nees"]
    assert (found["value"], found["inside"]) == (None, False)


def test_filters_are_compared_on_the_runs_that_both_finished(summary):
    (pair,) = summary["pairs"]
    difference = column("bad", "ate_rmse_m") - column("good", "ate_rmse_m")
    difference = difference[~np.isnan(difference)]
    low, high = scipy.stats.t.interval(
        0.95, RUNS - 2, difference.mean(), scipy.stats.sem(difference)
    )
    assert (pair["filter"], pair["reference"], pair["metric"]) == ("bad", "good", "ate_rmse_m")
    assert pair["n"] == RUNS - 1
    assert (pair["mean"], pair["low"], pair["high"]) == pytest.approx(
        (difference.mean(), low, high)
    )
    assert pair["median"] == pytest.approx(np.median(difference))
    assert pair["better"] == pytest.approx(np.mean(difference < 0))
    assert pair["p"] == pair["p_holm"] == scipy.stats.wilcoxon(difference).pvalue


def test_filters_that_do_the_same_do_not_differ():
    equal = [row(name, i, ate_rmse_m=0.1 * i) for i in range(5) for name in ("a", "b")]
    (pair,) = summarise([("", equal)])["pairs"]
    assert (pair["p"], pair["better"], pair["mean"]) == (1.0, 0.0, 0.0)


def test_holms_correction_is_that_of_the_textbook():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []


def test_what_is_kept_does_not_grow_with_the_runs(monkeypatch):
    monkeypatch.setattr(summaries, "MOST_RANKED", 20)
    few, many = summarise([("", rows(20))]), summarise([("", rows(2000))])
    assert [pair["n"] for pair in many["pairs"]] == [pair["n"] for pair in few["pairs"]] == [19]
    a, b = (group(s, "good")["metrics"]["ate_rmse_m"] for s in (few, many))
    assert a["median"] == b["median"]
    assert (a["n"], b["n"]) == (20, 2000)


def write(path, some):
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        table.writerows(some)
    return path


def test_a_table_read_back_gives_the_same_summary(tmp_path, summary):
    path = write(tmp_path / "results.csv", rows())
    assert compare([path]) == compare([tmp_path]) == summary


def test_one_filter_of_two_campaigns_is_compared_with_itself(tmp_path):
    good = [r for r in rows() if r["filter"] == "good"]
    first = write(tmp_path / "first.csv", good)
    second = write(tmp_path / "second.csv", [r | {"ate_rmse_m": 0.0} for r in good])
    found = compare([first, second])
    assert found["filters"] == [f"good ({first})", f"good ({second})"]
    (pair,) = found["pairs"]
    assert (pair["reference"], pair["n"], pair["better"]) == (f"good ({first})", RUNS, 1.0)


def test_metrics_of_runs_are_compared(tmp_path):
    data = simulate(scene(duration_s=1.0))
    paths = []
    for name in ("slam", "dead-reckoning"):
        values = metrics(run(data, resolve(name), name=name))
        paths.append(tmp_path / f"{name}.json")
        paths[-1].write_text(json.dumps(values))
    found = compare(paths)
    assert found["filters"] == ["slam", "dead-reckoning"]
    slam = group(found, "slam")["metrics"]["ate_rmse_m"]
    assert slam["mean"] == json.loads(paths[0].read_text())["ate_rmse_m"]
    assert (slam["low"], slam["std"]) == (None, None)
    assert found["pairs"] == []


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.txt", "", "expected a campaign's directory, its results"),
        (
            "a.csv",
            "x,y\n1,2\n",
            "expected the columns of a campaign's results, case is missing",
        ),
        ("a.csv", None, "cannot be read as results of a campaign"),
        (
            "a.csv",
            ",".join(COLUMNS) + "\n" + "x," * (len(COLUMNS) - 1),
            r"a.csv:2: expected a row of",
        ),
        ("a.json", "[3]", "expected metrics as simbench run writes them"),
        ("a.json", '{"source": 1}', "expected metrics as simbench run writes them"),
        ("a.parquet", "no", "cannot be read as results of a campaign"),
    ],
)
def test_what_is_no_result_is_refused(tmp_path, name, content, said):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(DatasetError, match=said):
        compare([tmp_path / name])


def test_an_empty_table_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected rows to compare, got none"):
        compare([write(tmp_path / "results.csv", [])])


def test_what_scenes_share_is_said_once_and_what_differs_is_a_column():
    other = [r | {"overrides": '{"a.b": 2}', "case": "other"} for r in rows()]
    both = ({"c.d": 0.5} | json.loads(r["overrides"]) for r in [*rows(), *other])
    all_rows = zip([*rows(), *other], both, strict=True)
    found = summarise([("", [r | {"overrides": json.dumps(o)} for r, o in all_rows])])
    table = tables(found)[0]
    assert table.title.startswith("room c.d=0.5: means")
    assert table.head[:2] == ("a.b", "filter")
    assert [line[:2] for line in table.rows] == [
        ("1", "good"),
        ("1", "bad"),
        ("2", "good"),
        ("2", "bad"),
    ]


def test_smoothed_errors_are_compared_where_there_are_some():
    alike = [r | {"smoothed_ate_rmse_m": r["ate_rmse_m"]} for r in rows()]
    groups, pairs = tables(summarise([("", alike)]))
    column = groups.head.index("smoothed ATE, m")
    assert [row[column] for row in groups.rows] == [row[column - 1] for row in groups.rows]
    assert [row[2] for row in pairs.rows] == ["ate_rmse_m", "smoothed_ate_rmse_m"]
    assert not any("smoothed" in head for head in tables(summarise([("", rows())]))[0].head)


def test_a_table_for_a_terminal_is_aligned(summary):
    _, head, good, bad, *notes = FORMATS["text"](tables(summary)[0])
    assert head.split()[:3] == ["filter", "runs", "lost"]
    assert good.split()[:3] == ["good", "40", "0"]
    assert bad.split()[:3] == ["bad", "40", "1"]
    assert head.index("ATE") == good.index("0.") == bad.rindex("0.", 0, head.index("ATE") + 2)
    assert "inf [" in bad
    assert bad.count(" !") == 1
    assert any(note.startswith("diverged: NEES of the pose at the end") for note in notes)


def test_markdown_has_as_many_cells_in_every_line():
    piped = [r | {"filter": f"{r['filter']}|x"} for r in rows()]
    lines = list(FORMATS["markdown"](tables(summarise([("", piped)]))[1]))
    body = [line.replace("\\|", "") for line in lines if line.startswith("|")]
    assert len(body) == 3
    assert {line.count("|") for line in body} == {10}


def test_latex_has_balanced_environments_and_escaped_words():
    named = [r | {"filter": f"{r['filter']}_a&b%"} for r in rows()]
    text = "\n".join(FORMATS["latex"](tables(summarise([("", named)]))[0]))
    assert r"good\_a\&b\%" in text
    for environment in ("table", "tabular"):
        assert text.count(rf"\begin{{{environment}}}") == text.count(rf"\end{{{environment}}}") == 1
    cells = [line for line in text.splitlines() if line.endswith(r" \\")]
    assert {line.count(" & ") for line in cells} == {10}


@pytest.mark.parametrize(
    ("arguments", "begins"),
    [
        ([], "room a.b=1: means"),
        (["--format", "markdown"], "**room a.b=1"),
        (["--format", "latex"], r"\begin"),
    ],
)
def test_the_verb_prints_tables(tmp_path, capsys, arguments, begins):
    write(tmp_path / "results.csv", rows())
    assert main(["compare", str(tmp_path), *arguments]) == 0
    assert capsys.readouterr().out.startswith(begins)


def test_the_verb_prints_json_alone(tmp_path, capsys, summary):
    write(tmp_path / "results.csv", rows())
    assert main(["compare", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == summary
