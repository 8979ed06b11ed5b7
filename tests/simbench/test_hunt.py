import json
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from simbench import hunt as hunting
from simbench.bugs import BUGS
from simbench.checks.audit import audit_drive
from simbench.checks.conformance import CHECKS, NOT_HUNTED
from simbench.checks.short_drive import ShortDrive
from simbench.cli import main
from simbench.errors import InputError
from simbench.filters import resolve
from simbench.hunt import clean_of, fault_in, hunt, judge, line_for_test, write
from simbench.mcap import read_dataset_mcap
from simbench.scenario import load
from simbench.sensors import simulate
from vislam.filters import EkfSlam, Parts, model
from vislam.lie import se3


def wrong_sign(T, T_next):
    return se3.adjoint(se3.inverse(T) @ T_next)


def without_cross_covariance(*arguments):
    landmarks, G, R = model.inverse_observation(*arguments)
    return landmarks, np.zeros_like(G), R


def mean_interval(noise, motion, dt):  # noqa: ARG001
    return model.process_noise(noise, motion, 1.0)


WRONG_SIGN = partial(EkfSlam, parts=Parts(transition=wrong_sign))
NO_CROSS = partial(EkfSlam, parts=Parts(birth=without_cross_covariance))
MEAN_INTERVAL = partial(EkfSlam, parts=Parts(process_noise=mean_interval))


@pytest.fixture
def few_draws(monkeypatch):
    monkeypatch.setattr(hunting, "MOST_DRAWN", 12)


@pytest.mark.parametrize(
    ("factory", "begins"),
    [
        (WRONG_SIGN, "predict 0: pose-landmark cross-covariance"),
        (NO_CROSS, "update 0: landmark covariance (age 0)"),
        (MEAN_INTERVAL, "predict 0: pose covariance"),
    ],
)
def test_planted_mistake_is_found_in_two_frames_and_one_landmark(factory, begins):
    found = hunt(factory, judge("audit"), clean=EkfSlam).found
    assert (found.frames, found.landmarks) == (2, 1)
    assert found.reason.startswith(begins)


@pytest.mark.usefixtures("few_draws")
def test_nothing_is_found_of_a_right_filter():
    result = hunt(EkfSlam, judge("audit"))
    assert (result.found, result.ended) == (None, "done")
    assert result.tried >= 6


@pytest.mark.usefixtures("few_draws")
def test_scene_where_the_clean_filter_fails_too_is_none():
    assert hunt(NO_CROSS, judge("audit"), clean=WRONG_SIGN).found is None


def test_same_seed_finds_the_same_scene_by_the_same_way():
    once, again, other = (hunt(WRONG_SIGN, judge("audit"), seed=seed) for seed in (5, 5, 6))
    assert once == again
    assert once.found == other.found


def test_written_scene_shows_the_fault_and_the_clean_filter_passes_it(tmp_path):
    found = hunt(WRONG_SIGN, judge("audit"), clean=EkfSlam).found
    path, recording = write(found, "my:filter", "audit", tmp_path / "out")
    scene = load(path)
    drive = ShortDrive.of(simulate(scene), 2000)
    assert str(audit_drive(WRONG_SIGN, drive).first) == found.reason
    assert audit_drive(EkfSlam, drive).passed
    assert scene.name == path.stem == recording.stem == "hunt-audit-my_filter"
    assert found.reason in scene.about
    recorded = read_dataset_mcap(recording)
    np.testing.assert_array_equal(recorded.sightings.pixels, drive.dataset.sightings.pixels)


def test_line_for_a_test_fails_with_the_bug_and_passes_without(tmp_path):
    name = "slam+cross-covariance-not-propagated"
    found = hunt(resolve(name), judge("audit"), clean=clean_of(name)).found
    path, _ = write(found, name, "audit", tmp_path)
    line = line_for_test(path, name, "audit")
    with pytest.raises(AssertionError):
        exec(line, {"fault_in": fault_in})
    exec(line.replace(f'"{name}"', '"slam"'), {"fault_in": fault_in})


def test_other_checks_are_hunted_by_name():
    found = hunt(resolve("slam"), judge("null-space"), max_seconds=60).found
    assert found.frames <= 6
    assert "motion of the world" in found.reason


def test_clean_filter_is_the_base_of_the_bug():
    assert clean_of("slam") is None
    assert clean_of("package:factory") is None
    assert clean_of("slam+fused-twice") is resolve("slam")
    bug = next(name for name, bug in BUGS.items() if bug.base == "slam-fej")
    assert clean_of(f"slam+{bug}") is resolve("slam-fej")
    assert clean_of("slam-transport+fused-twice") is resolve("slam-transport")


def test_unknown_check_is_refused():
    with pytest.raises(InputError, match="Expected the name of a check, got 'nullspace'"):
        judge("nullspace")


@pytest.mark.parametrize(
    "check", ["rest-teaches-nothing", "a-step-teaches-nothing", "refuse-as-often-as-told"]
)
def test_check_that_tells_nothing_of_a_scene_is_refused_with_those_that_do(check, capsys):
    assert main(["hunt", "--filter", "slam", "--check", check]) == 2
    message = capsys.readouterr().err
    assert f"{check} has a scene of its own or counts" in message
    assert "A hunt takes audit, exact-audit, move-the-world" in message
    assert message.count(check) == 1


def test_every_check_that_may_be_hunted_looks_at_its_scene():
    class Looked(Exception):
        pass

    class Scene:
        def __getattr__(self, name):
            raise Looked

    for name in set(CHECKS) - NOT_HUNTED:
        with pytest.raises(Looked):
            judge(name)(EkfSlam, Scene())


def interrupting(after):
    """The audit, interrupted at its call number `after`."""
    calls = iter(range(after))

    def judged(factory, drive):
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return judge("audit")(factory, drive)

    return judged


def test_interrupted_hunt_keeps_what_it_found():
    result = hunt(MEAN_INTERVAL, interrupting(8))
    assert result.ended == "interrupted"
    assert result.found is not None
    assert hunt(MEAN_INTERVAL, interrupting(0)).found is None


def test_hunt_out_of_time_keeps_what_it_found(monkeypatch):
    seconds = iter(range(1000))
    clock = SimpleNamespace(monotonic=lambda: next(seconds))
    monkeypatch.setattr(hunting, "time", clock)
    result = hunt(MEAN_INTERVAL, judge("audit"), max_seconds=8.5)
    assert (result.ended, result.tried) == ("time", 8)
    assert result.found is not None


FAULTY = """
from functools import partial
from vislam.filters import EkfSlam, Parts
from vislam.lie import se3

factory = partial(EkfSlam, parts=Parts(transition=lambda T, U: se3.adjoint(se3.inverse(T) @ U)))
"""


@pytest.fixture
def faulty(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "faulty_for_hunt.py").write_text(FAULTY)
    return "faulty_for_hunt:factory"


def test_verb_writes_the_scene_that_the_audit_shows_again(faulty, tmp_path, capsys):
    assert main(["hunt", "--filter", faulty, "--json"]) == 1
    values = json.loads(capsys.readouterr().out)
    assert values["found"]
    assert (values["frames"], values["landmarks"], values["check"]) == (2, 1, "audit")
    assert main(["audit", "--scene", values["scenario"], "--filter", faulty]) == 1
    assert values["reason"] in capsys.readouterr().out
    assert main(["audit", "--scene", values["scenario"], "--filter", "slam"]) == 0
    assert not (tmp_path / ".hypothesis").exists()


@pytest.mark.usefixtures("few_draws")
def test_verb_finds_nothing_wrong_with_slam(tmp_path, capsys):
    assert main(["hunt", "--filter", "slam", "--json", "--out", str(tmp_path / "out")]) == 0
    values = json.loads(capsys.readouterr().out)
    nothing = ("scenario", "frames", "landmarks", "reason")
    assert values["found"] is False
    assert [values[key] for key in nothing] == [None] * 4
    assert not (tmp_path / "out").exists()


def test_interrupted_verb_writes_the_smallest_so_far(faulty, monkeypatch, capsys):
    monkeypatch.setattr(hunting, "judge", lambda _: interrupting(2))
    assert main(["hunt", "--filter", faulty, "--json"]) == 130
    values = json.loads(capsys.readouterr().out)
    assert values["ended"] == "interrupted"
    assert load(values["scenario"]).about.endswith(values["reason"])


def test_verb_refuses_an_unknown_check(capsys):
    assert main(["hunt", "--filter", "slam", "--check", "luck"]) == 2
    assert "Expected the name of a check, got 'luck'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, bug in BUGS.items() if "audit" in bug.checks])
def test_every_bug_that_the_audit_sees_shows_in_six_frames_and_six_landmarks(name):
    clean = clean_of(f"slam+{name}")
    found = hunt(resolve(f"slam+{name}"), judge("audit"), clean=clean, max_seconds=60).found
    assert found.frames <= 6
    assert found.landmarks <= 6
