import json
import re
import shlex
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import html5lib
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from simbench.bugs.bug import CHECKS as COLUMNS
from simbench.checks.conformance import CHECKS
from simbench.cli import cli, main
from simbench.errors import InputError, OutputError
from simbench.mcap import RecordedRun, write_dataset_mcap
from simbench.report import meaning, report, sections, write_report
from simbench.report.numbers import number, parts
from simbench.report.page import Cell, Layer, html, table
from simbench.report.runs import METRICS
from tests.simbench import reports
from tests.simbench.records import circle

HOSTILE = "<script>alert(1)</script>"
BREAKERS = [
    HOSTILE,
    '"><img src=x onerror=alert(1)>',
    "' onmouseover='alert(1)",
    "</script></style></svg></title>-->]]>",
    "{{ 7 * 7 }}{% raw %}",
    "a$b$\\frac{",
    "_hidden",
    "\x00\x1b[31m\r\n\ud800￿",
    "$(reboot); `reboot`",
    "x" * 300,
]


@pytest.fixture(scope="module")
def given_files(tmp_path_factory):
    """One file of each kind."""
    here = tmp_path_factory.mktemp("files")
    record = here / "short.slam.mcap"
    reports.recorded(record)
    return [
        record,
        reports.written(here / "audit.json", [reports.audit(), reports.audit("mine:Filter")]),
        reports.written(here / "check.json", reports.verdict()),
        reports.written(here / "bugs.json", reports.matrix()),
        reports.written(here / "run.json", reports.measured()),
        reports.campaign(here / "study"),
    ]


@pytest.fixture(scope="module")
def page(given_files):
    return report(given_files)


def parsed(page):
    """The tree of a page; fails where the standard's own parser finds a fault."""
    parser = html5lib.HTMLParser(strict=True, namespaceHTMLElements=False)
    return parser.parse(page)


def test_a_page_is_valid_html(page):
    tree = parsed(page)
    assert len(tree.findall(".//section")) == 7
    ids = [e.get("id") for e in tree.iter() if e.get("id")]
    assert len(ids) == len(set(ids))


def test_a_page_loads_nothing(page):
    assert not re.search(r"https?:|//\w|@import|url\((?!#)", page.split("<script>")[0])
    tree = parsed(page)
    for element in tree.iter():
        for name, value in element.items():
            if str(name).endswith(("src", "href", "action", "data")):
                assert value.startswith(("#", "data:")), (name, value)
        assert element.tag not in {"iframe", "object", "embed", "base", "form"}
    for script in tree.findall(".//script"):
        assert not re.search(r"fetch|XMLHttp|import\(|WebSocket|sendBeacon", script.text)


def test_the_policy_allows_the_pages_own_script_alone(page):
    import base64
    import hashlib

    tree = parsed(page)
    (policy,) = (m.get("content") for m in tree.iter("meta") if m.get("http-equiv"))
    (script,) = (s.text for s in tree.iter("script") if s.get("type") is None)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert "default-src 'none'" in policy
    assert f"script-src 'sha256-{digest}';" in policy


def test_equal_inputs_give_equal_bytes(given_files, page, tmp_path):
    code = (
        "import sys; from pathlib import Path; from simbench.report import write_report;"
        "write_report([Path(p) for p in sys.argv[2:]], Path(sys.argv[1]))"
    )
    subprocess.run([sys.executable, "-c", code, tmp_path / "r.html", *given_files], check=True)
    assert (tmp_path / "r.html").read_bytes() == page.encode()


def test_the_verdict_stands_before_everything_else_of_its_section(page):
    for section in parsed(page).iter("section"):
        heading, first = list(section)[:2]
        assert heading.tag == "h2"
        assert first.get("class").split()[0] == "verdict"


def test_every_section_says_how_it_is_made_again(page):
    for section in parsed(page).iter("section"):
        commands = ["".join(code.itertext()) for code in section.iter("code")]
        assert commands
        for command in commands:
            words = shlex.split(command)
            assert words[0] in {"simbench", "pytest"}
            assert words[0] == "pytest" or words[1] in {*cli.commands, "campaign"}


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (
            reports.audit,
            "simbench audit --filter slam+bug --scene slam+bug --most-scalars 100 --seed 3 --run 1 "
            "--set name=slam+bug",
        ),
        (
            reports.verdict,
            "simbench check slam --filter slam --runs 20 --false-alarm 0.01 --seed 19 "
            "--set name=slam",
        ),
    ],
)
def test_the_command_has_every_option_that_was_given(tmp_path, make, expected):
    (section,) = sections(reports.written(tmp_path / "a.json", make()))
    assert section.again == (expected,)


def test_a_failed_check_says_what_it_means_and_which_run_shows_it(tmp_path):
    (section,) = sections(reports.written(tmp_path / "a.json", reports.verdict()))
    chance, law = section.findings
    assert chance.means == "means slam"
    assert chance.commands == ("simbench run slam --filter slam --seed 19 --run 4 --set name=slam",)
    assert law.names == ("jacobians",)
    assert "derivative" in law.means
    assert law.commands == ("simbench hunt --filter slam --check jacobians",)


def test_every_check_has_a_meaning():
    for name in CHECKS:
        if name != "exact-audit":
            assert len(meaning.of_law(name)) > len(CHECKS[name]) + 40, name


def test_a_missed_bug_fails_its_matrix(tmp_path):
    (section,) = sections(reports.written(tmp_path / "a.json", reports.matrix()))
    assert section.passed is False
    assert [f.names for f in section.findings] == [("pixel-noise-twice",)]
    assert section.again == ("simbench bugs --matrix --runs 400",)
    caught = {"pixel-noise-twice": {"audit": {"caught": True, "statistic": 1.0, "reason": "x"}}}
    (section,) = sections(reports.written(tmp_path / "b.json", caught))
    assert section.passed is True
    control = {"control-reset": {"audit": {"caught": True, "statistic": 1.0, "reason": "x"}}}
    (section,) = sections(reports.written(tmp_path / "c.json", control))
    assert section.passed is False
    assert "audit" in COLUMNS


def test_a_campaign_names_its_failed_run_and_the_one_furthest_out(tmp_path):
    directory = reports.campaign(tmp_path / "study", "other")
    (section,) = sections(directory)
    raised, too_sure, check = section.findings
    scene = directory / "scenes" / "c0.yaml"
    assert raised.commands == (f"simbench run {scene} --filter other --seed 7 --run 3",)
    assert too_sure.commands == (f"simbench run {scene} --filter other --seed 7 --run 3",)
    assert too_sure.means.startswith("Too sure")
    assert check.names == ("other: other",)


def test_many_bands_are_wider_than_one(tmp_path):
    """2.0 is outside the 95 % band of 24 degrees of freedom, not outside that of forty such."""
    directory = reports.campaign(tmp_path / "study", failed=0)
    path = directory / "summary.json"
    summary = json.loads(path.read_text())
    summary["checks"] = []
    summary["groups"][0]["nees"] |= {"value": 1.8}
    reports.written(path, summary)
    (alone,) = sections(directory)
    assert len(alone.findings) == 1
    good = {"value": 1.0, "low": 0.5, "high": 1.7, "dof": 24, "inside": True}
    summary["groups"] += [summary["groups"][1] | {"nees": good}] * 39
    reports.written(path, summary)
    (among_many,) = sections(directory)
    assert among_many.findings == ()
    assert among_many.passed is True


def test_a_run_has_all_its_metrics_and_its_scene(given_files):
    (section,) = sections(given_files[0])
    measured = next(b for b in section.blocks if b.kind == "table")
    assert {row[-1].text for row in measured.rows} - {"noise_fit"} <= set(METRICS)
    assert len(measured.rows) >= 15
    assert section.facts["seed"] == "3"
    (scene,) = (b for b in section.blocks if b.kind == "text")
    assert "duration_s: 2.0" in scene.text


def test_the_json_beside_a_recording_brings_the_recording(given_files, tmp_path):
    for suffix in (".mcap", ".json"):
        path = tmp_path / f"short.slam{suffix}"
        path.write_bytes(given_files[0].read_bytes())
    reports.written(path, reports.measured() | {"wall_s": 1.25})
    (section,) = sections(path)
    assert any(block.kind == "view" for block in section.blocks)
    assert "1.25" in html([section])


def test_a_view_holds_what_the_run_made(given_files, tmp_path):
    record = reports.recorded(tmp_path / "again.mcap")
    (section,) = sections(given_files[0])
    view = section.blocks[0]
    layers = {layer.name: layer.points for layer in view.layers}
    truth = record.dataset.truth
    np.testing.assert_allclose(layers["true path"], truth.T_world_imu[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(layers["estimated path"], record.T_world_imu[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(layers["estimated landmarks"], record.final.landmarks, atol=1e-5)
    (path,) = (one for one in view.as_json() if one["color"] == "--blue")
    np.testing.assert_allclose(
        np.reshape(path["mm"], (-1, 3)) / 1000, record.T_world_imu[:, :3, 3], atol=6e-4
    )


def test_a_long_drive_takes_less_than_half_of_six_megabytes(monkeypatch, tmp_path):
    record = circle(frames=1500, landmarks=20_000).record
    found = RecordedRun(
        record=record,
        nees=np.linspace(1, 12, 1500),
        nis=np.full(1500, 40.0),
        nis_dof=np.full(1500, 40),
        metrics={},
    )
    monkeypatch.setattr("simbench.report.runs.read_run_mcap", lambda _: found)
    write_report([Path("a.mcap")], tmp_path / "r.html")
    assert (tmp_path / "r.html").stat().st_size < 3e6


def test_a_page_that_would_be_too_large_is_refused(monkeypatch, given_files, tmp_path):
    monkeypatch.setattr("simbench.report.MOST_BYTES", 10_000)
    with pytest.raises(OutputError, match="Give fewer files"):
        write_report([given_files[3]], tmp_path / "r.html")
    assert list(tmp_path.iterdir()) == []


def everywhere(text, directory):
    """A page of every kind of file, with a text in each field that holds one."""
    directory.mkdir(exist_ok=True)
    files = [
        reports.written(directory / "a.json", reports.audit(text)),
        reports.written(directory / "v.json", reports.verdict(text)),
        reports.written(directory / "m.json", reports.matrix(text)),
        reports.written(directory / "r.json", reports.measured(text)),
        reports.campaign(directory / "c", text.encode(errors="replace").decode()),
    ]
    return report(files)


def tags(page):
    """How often each element and attribute of a page occurs, the drawings apart."""
    tree = html5lib.HTMLParser(namespaceHTMLElements=False).parse(page)
    for parent in tree.iter():
        for drawing in parent.findall("{http://www.w3.org/2000/svg}svg"):
            parent.remove(drawing)
    found = Counter(e.tag for e in tree.iter())
    return found + Counter(str(name) for e in tree.iter() for name in e.keys())  # noqa: SIM118


@pytest.fixture(scope="module")
def harmless(tmp_path_factory):
    return tags(everywhere("harmless", tmp_path_factory.mktemp("harmless")))


@given(text=st.text(min_size=1, max_size=40))
@settings(max_examples=3, deadline=None)
@example(text=HOSTILE)
@example(text=BREAKERS[3])
@example(text=BREAKERS[5])
@example(text=BREAKERS[7])
def test_a_text_is_a_text_wherever_it_stands(harmless, tmp_path_factory, text):
    page = everywhere(text, tmp_path_factory.mktemp("hostile"))
    page.encode()
    assert tags(page) == harmless


@pytest.mark.parametrize("text", [HOSTILE, BREAKERS[4]])
def test_a_text_is_shown_as_it_is(tmp_path, text):
    tree = parsed(everywhere(text, tmp_path))
    shown = [heading for heading in tree.iter("h2") if text in "".join(heading.itertext())]
    assert len(shown) >= 3


def test_a_hostile_scenario_keeps_its_name(tmp_path):
    path = tmp_path / "hostile.mcap"
    reports.recorded(path, name=HOSTILE, filter_=HOSTILE)
    tree = parsed(report([path]))
    (heading,) = tree.iter("h2")
    assert "".join(heading.itertext()).strip() == f"run {HOSTILE}, {HOSTILE}"
    (command,) = ("".join(code.itertext()) for code in tree.iter("code"))
    assert shlex.split(command) == ["simbench", "run", str(path), "--filter", HOSTILE]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("nonsense", "expected a recording"),
        ("{}", "this is none of them"),
        ("[1]", "this is none of them"),
        ('{"a": {"b": {"caught": 3}}}', r"a\.b\.caught"),
        (json.dumps(reports.verdict() | {"runs": "many"}), "runs: expected what a verb prints"),
        (json.dumps(reports.audit() | {"deviations": {"x": {}}}), "deviations"),
    ],
)
def test_a_file_of_another_kind_is_refused_by_name(tmp_path, content, message):
    path = tmp_path / "file.json"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as refused:
        report([path])
    assert str(path) in str(refused.value)


def test_a_directory_and_a_recording_without_a_run_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"there is no summary\.json"):
        report([tmp_path])
    record = reports.recorded(tmp_path / "a.mcap")
    write_dataset_mcap(tmp_path / "data.mcap", record.dataset)
    with pytest.raises(InputError, match="got one of a dataset alone"):
        report([tmp_path / "data.mcap"])


def test_the_verb_writes_the_page_and_says_what_is_in_it(given_files, tmp_path, capsys):
    out = tmp_path / "new" / "page.html"
    assert main(["report", *map(str, given_files[2:5]), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["file"] == str(out)
    assert said["bytes"] == out.stat().st_size
    outcomes = [section["outcome"] for section in said["sections"]]
    assert outcomes == ["failed", "failed", "measured"]
    assert main(["report", str(tmp_path / "nothing.json")]) == 2
    assert "nothing.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (True, "yes"),
        (-12, "−12"),
        (0.0, "0"),
        (0.072923, "0.07292"),
        (-1.33166e-8, "−1.332×10⁻⁸"),
        (1e-8, "1×10⁻⁸"),
        (2.5e7, "2.5×10⁷"),
        (11615.4, "11620"),
        (9999.96, "10000"),
        (40.0, "40"),
        ("text", "text"),
    ],
)
def test_numbers_are_written_for_people(value, text):
    assert number(value) == text
    assert "".join(parts(text)) == text


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False) | st.none(), min_size=1))
def test_a_column_of_numbers_leaves_room_behind_the_longest(values):
    made = table("t", ("x",), [(v,) for v in values])
    if any(v is not None for v in values):
        (width,) = made.widths()
        assert width == max(len(parts(number(v))[1]) for v in values)


def test_a_column_with_a_word_in_it_is_no_column_of_numbers():
    made = table("t", ("a", "b"), [(1.0, 1.0), ("x", None), (2, Cell(text="3", key=3.0))])
    assert made.numeric == frozenset()


def test_a_layer_is_written_in_whole_millimetres():
    layer = Layer(name="a", shape="line", color="--ink", points=np.array([[0.0015, -1.2, 3]]))
    assert layer.as_json()["mm"] == [2, -1200, 3000]
    assert replace(layer, dashed=True).as_json()["dashed"] is True
