"""The bug catalogue: each bug shows where the table says, and nowhere else."""

import importlib
import json
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from simbench.bugs import BUGS, CHECKS, PARTS, mutant
from simbench.bugs.matrix import COLUMNS, Cell, matrix, missed, table
from simbench.checks.audit import audit_drive
from simbench.checks.scenes import SCENES, drive
from simbench.cli import main
from simbench.errors import InputError
from simbench.filters import FILTERS, resolve
from tests.vislam.drives import in_parts_of
from vislam.gaussian import NotPositiveDefinite

SEEN = {name: bug for name, bug in BUGS.items() if bug.audit}
BLIND = {name: bug for name, bug in BUGS.items() if not bug.audit}
#: Draws noise of its own: a batch draws other numbers than single runs.
CHANCE = "pixel-noise-twice"


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize(
    "bug",
    [
        *("unseen-landmarks-left", "fancy-index-write-into-a-copy"),
        *("pose-and-map-as-two-filters", "no-pose-jacobian"),
    ],
)
def test_a_mistake_is_the_same_however_many_sightings_a_frame_has(name, bug):
    def held():
        with suppress(NotPositiveDefinite):  # as some of them end
            yield from beliefs(mutant(f"{name}+{bug}"), w)

    w = np.random.default_rng(0).standard_normal(drive("births").scalars)
    at_once = list(held())
    with in_parts_of(1):
        by_parts = list(held())
    assert len(at_once) > 1
    for one, other in zip(at_once, by_parts, strict=True):
        assert np.allclose(one.T_world_imu, other.T_world_imu, rtol=0, atol=1e-9)
        assert np.allclose(one.joint_covariance, other.joint_covariance, rtol=0, atol=1e-9)


def beliefs(factory, w, gate=None):
    """What a filter holds after each call of a drive with noise w."""
    d = drive("births")
    readings = d.realise(w)
    filter_ = factory(replace(d.task, prior=readings.prior, gate=gate))
    for i, frame in enumerate(readings.frames):
        if i:
            filter_.predict(readings.twists[i - 1], float(d.intervals_s[i - 1]))
            yield filter_.belief(joint=True)
        filter_.update(frame)
        yield filter_.belief(joint=True)


def noise(*shape):
    return np.random.default_rng(0).standard_normal((*shape, drive("births").scalars))


def differs(a, b, tolerance=1e-9):
    """Whether two filters ever held different things."""
    return any(
        not np.allclose(x.T_world_imu, y.T_world_imu, rtol=0, atol=tolerance)
        or x.ids.tolist() != y.ids.tolist()
        or not np.allclose(x.joint_covariance, y.joint_covariance, rtol=0, atol=tolerance)
        for x, y in zip(a, b, strict=True)
    )


@pytest.fixture(scope="module")
def found():
    """The whole matrix; its audit is of the scene `births`."""
    return matrix()


@pytest.mark.parametrize("name", SEEN)
def test_the_audit_names_the_call_and_block_of_the_table(name, found):
    trace, reason = SEEN[name].audit, found[name]["audit"].reason
    if trace.scene != "births":
        reason = str(audit_drive(mutant(f"slam+{name}"), drive(trace.scene)))
    expected = f"{trace}, claimed"
    if trace.block == "estimate":
        expected = f"{trace.call} is wrong even without noise"
    assert reason.startswith(expected)


@pytest.mark.parametrize("name", BLIND)
def test_the_audit_is_blind_where_the_table_says_so(name, found):
    assert not found[name]["audit"].reason
    for scene in ("density", "gaps"):
        assert audit_drive(mutant(f"slam+{name}"), drive(scene)).passed


@pytest.mark.parametrize("base", PARTS)
def test_the_audit_passes_each_base(base):
    assert audit_drive(resolve(base), drive("gaps")).passed


@pytest.mark.parametrize("name", [name for name in BUGS if name != "gate-of-wrong-dof"])
def test_every_bug_changes_what_its_base_holds_at_real_noise(name):
    base = resolve(BUGS[name].base)
    tolerance = 0 if name == "covariance-never-symmetrised" else 1e-9
    assert differs(beliefs(base, noise()), beliefs(mutant(f"slam+{name}"), noise()), tolerance)


@pytest.mark.parametrize("name", ["first-estimates-in-h-alone", "first-estimate-of-the-pose-alone"])
def test_mixed_linearisation_points_are_one_where_there_is_no_noise(name):
    none = 0 * noise()
    assert not differs(beliefs(resolve("slam-fej"), none), beliefs(mutant(f"slam+{name}"), none))


def test_a_covariance_never_symmetrised_drifts_from_symmetry_by_rounding_alone():
    clean = [b.joint_covariance for b in beliefs(resolve("slam"), noise())]
    found = [
        b.joint_covariance for b in beliefs(mutant("slam+covariance-never-symmetrised"), noise())
    ]
    assert all(np.array_equal(P, P.T) for P in clean)
    assert any(not np.array_equal(P, P.T) for P in found)
    assert all(np.allclose(P, Q, rtol=0, atol=1e-12) for P, Q in zip(clean, found, strict=True))


def test_the_gate_of_the_wrong_dof_refuses_more_than_it_is_told():
    gate = mutant("slam+gate-of-wrong-dof")(drive("births").task).parts.gate
    distances = chi2(4).ppf(np.linspace(0, 1, 1001)[:-1])
    share = np.mean(gate(distances, 0.95, 4))
    assert share == pytest.approx(chi2(4).cdf(chi2(2).ppf(0.95)), abs=2e-3)
    assert share < 0.9


@pytest.mark.parametrize("name", [name for name in BUGS if name != CHANCE])
def test_a_batch_of_runs_equals_the_runs_one_by_one(name):
    factory, w = mutant(f"slam+{name}"), 0.1 * noise(3)
    together = list(beliefs(factory, w, gate=0.9))
    for k in range(3):
        for both, alone in zip(together, beliefs(factory, w[k], gate=0.9), strict=True):
            for field in ("T_world_imu", "landmarks", "joint_covariance"):
                one = getattr(alone, field)
                many = np.broadcast_to(getattr(both, field), (3, *one.shape))
                assert np.allclose(many[k], one, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", BUGS)
def test_what_must_catch_a_bug_does_and_nothing_catches_a_control(name, found):
    assert missed(name, found[name]) == []
    if not BUGS[name].control:
        assert any(cell.caught for cell in found[name].values())


def test_the_matrix_marks_what_is_missed(found):
    blind = dict.fromkeys(found["fused-twice"], Cell(caught=False))
    seeing = dict.fromkeys(blind, Cell(caught=True))
    assert missed("fused-twice", blind) == ["audit"]
    assert missed("control-reset", seeing) == list(COLUMNS)
    lines = table({"fused-twice": blind, "gate-of-wrong-dof": found["gate-of-wrong-dof"]})
    assert [line.split() for line in lines.splitlines()] == [
        list(COLUMNS),
        ["fused-twice", "!", ".", ".", ".", ".", ".", "."],
        ["gate-of-wrong-dof", ".", ".", ".", ".", ".", ".", "x"],
    ]


def test_a_cell_is_json_without_infinity():
    cell = Cell(caught=True, statistic=float("inf"), reason="lost")
    assert cell.as_json() == {"caught": True, "statistic": None, "reason": "lost"}


def test_equal_inputs_give_equal_numbers():
    runs = [list(beliefs(mutant(f"slam+{CHANCE}"), noise())) for _ in range(2)]
    assert not differs(*runs, tolerance=0)


def test_the_catalogue_holds_the_bugs_that_it_should():
    controls = [name for name, bug in BUGS.items() if bug.control]
    assert controls == ["control-adjoint-4x4", "control-reset"]
    assert len(BUGS) - len(controls) >= 24


@pytest.mark.parametrize(("name", "bug"), BUGS.items(), ids=BUGS)
def test_an_entry_says_all_that_it_must(name, bug):
    assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)+", name)
    assert bug.what.endswith(".")
    assert bug.source
    assert set(bug.checks) <= set(CHECKS)
    assert bool(bug.audit) != bool(bug.blind)
    assert bug.control or bool(bug.audit) == ("audit" in bug.checks)
    assert bug.audit is None or bug.audit.scene in SCENES
    assert bug.base in PARTS


@pytest.mark.parametrize(("base", "parts"), PARTS.items())
def test_the_parts_of_a_base_are_those_of_the_filter_of_that_name(base, parts):
    module, _, name = parts.partition(":")
    filter_ = resolve(base)(drive("births").task)
    assert filter_.parts is getattr(importlib.import_module(module), name)
    assert base in FILTERS


def test_a_base_that_is_written_overrules_the_bugs_own():
    task = drive("births").task
    own = resolve("slam+adjoint-of-wrong-sign")(task).parts
    written = resolve("slam-transport+adjoint-of-wrong-sign")(task).parts
    assert own.linearise is resolve("slam-fej")(task).parts.linearise
    assert written.transport is resolve("slam-transport")(task).parts.transport
    assert own.transition is written.transition


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("slam+left-retractoin", "no bug 'left-retractoin'. Did you mean left-retraction?"),
        ("slam+zzz", "no bug 'zzz'. `simbench list bugs` names all."),
        ("slam-fe+left-retraction", "no base filter 'slam-fe'. Did you mean slam-fej?"),
        ("mapping+left-retraction", "no base filter 'mapping'. There are slam, slam-fej"),
    ],
)
def test_an_unknown_bug_or_base_gets_a_hint(name, message):
    with pytest.raises(InputError, match=re.escape(message)):
        resolve(name)


def test_the_catalogue_is_listed_without_numpy():
    script = "import sys, simbench.filters, simbench.bugs; assert 'numpy' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_list_bugs_gives_name_and_sentence(capsys):
    assert main(["list", "bugs", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {name: bug.what for name, bug in BUGS.items()}


def test_bugs_lists_the_catalogue(capsys):
    assert main(["bugs", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [entry["name"] for entry in listed] == list(BUGS)
    first = listed[0]
    assert first["checks"] == ["audit", "nees", "landmark-nees"]
    assert first["audit"]["call"] == "update 0"
    assert main(["bugs"]) == 0
    assert "audit      update 0: pose-landmark cross-covariance" in capsys.readouterr().out


def test_a_bug_is_audited_by_its_name(capsys):
    assert main(["audit", "--filter", "slam+input-of-another-interval"]) == 1
    assert "predict 1 is wrong even without noise" in capsys.readouterr().out
