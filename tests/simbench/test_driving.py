"""A filter that is none is a result, with the call that shows it: of a run, an audit, a verdict."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from simbench.checks import gate
from simbench.checks.audit import audit_drive
from simbench.checks.scenes import drive
from simbench.checks.trace import Feed, trace
from simbench.cli import main
from simbench.driving import Driven, checked
from simbench.errors import FilterFailure, InputError
from simbench.run import run
from tests.simbench.checked import wrapped
from vislam.filters import EkfSlam
from vislam.types import Belief

DRIVE = drive("births")


def without_update(task):
    made = EkfSlam(task)
    return SimpleNamespace(predict=made.predict, belief=made.belief)


class Three(EkfSlam):
    def update(self, frame):
        super().update(frame)
        return 3


class Unwhitened(EkfSlam):
    def update(self, frame):
        innovation = super().update(frame)
        return replace(innovation, whitened=innovation.whitened * np.nan)


class FlatInnovation(EkfSlam):
    def update(self, frame):
        innovation = super().update(frame)
        return replace(innovation, whitened=innovation.whitened[..., :3])


class LossyEnd(EkfSlam):
    def finish(self):
        belief = self.belief()
        return replace(belief, ids=np.arange(3), landmarks=np.zeros((2, 3)))


def leaving(**changes):
    """EkfSlam, whose beliefs are changed from the first update on."""
    return wrapped(EkfSlam, belief=lambda b: replace(b, **changes) if len(b.ids) else b)


def few_landmarks(belief):
    return replace(belief, landmarks=belief.landmarks[..., :-1, :]) if len(belief.ids) else belief


def nan_at(field, *element):
    def change(belief):
        array = getattr(belief, field)
        if array is None or not len(belief.ids):
            return belief
        array = array.copy()
        array[element] = np.nan
        return replace(belief, **{field: array})

    return wrapped(EkfSlam, belief=change)


WRONG = {
    "no update": (without_update, "start", "gave what is no filter: SimpleNamespace has no method"),
    "update gives 3": (Three, "update 0", "returned int: expected an Innovation or None"),
    "innovation NaN": (Unwhitened, "update 1", "returned `whitened` that is not finite"),
    "innovation flat": (FlatInnovation, "update 0", r"returned `whitened` of shape \(0, 3\)"),
    "pose covariance": (
        leaving(pose_covariance=np.eye(5)),
        "update 0",
        r"left `pose_covariance` of shape \(5, 5\), expected \(6, 6\)",
    ),
    "no belief": (
        wrapped(EkfSlam, belief=lambda _: None),
        "update 0",
        "left NoneType: expected a vislam.types.Belief",
    ),
    "few landmarks": (
        wrapped(EkfSlam, belief=few_landmarks),
        "update 0",
        "left `landmarks` of shape",
    ),
    "few at the end": (
        LossyEnd,
        "finish",
        r"left `landmarks` of shape \(2, 3\), expected \(3, 3\)",
    ),
    "ids": (leaving(ids=[1, 2]), "update 0", "left `ids` that are no row of integers"),
    "landmark covariances": (
        leaving(landmark_covariances=np.eye(3)),
        "update 0",
        r"left `landmark_covariances` of shape \(3, 3\)",
    ),
    "no landmark covariances": (
        leaving(landmark_covariances=None),
        "update 0",
        "left `landmark_covariances` that is no array of numbers: None",
    ),
    "pose covariance NaN": (
        nan_at("pose_covariance", ..., 0, 0),
        "update 0",
        "left `pose_covariance` that is not finite",
    ),
    "landmark covariances NaN": (
        nan_at("landmark_covariances", ...),
        "update 0",
        "left `landmark_covariances` that is not finite",
    ),
}
ONLY_JOINT = {
    "cross covariance NaN": (
        nan_at("joint_covariance", ..., 0, -1),
        "update 0",
        "left `joint_covariance` that is not finite",
    ),
    "joint covariance": (
        wrapped(
            EkfSlam,
            belief=lambda b: (
                b if b.joint_covariance is None else replace(b, joint_covariance=np.eye(7))
            ),
        ),
        "update 0",
        r"left `joint_covariance` of shape \(7, 7\)",
    ),
}


def cases(table):
    return pytest.mark.parametrize(("factory", "call", "reason"), table.values(), ids=table.keys())


@cases(WRONG)
def test_run_names_the_call(factory, call, reason):
    with pytest.raises(FilterFailure, match=f"^{call} {reason}"):
        run(DRIVE.dataset, factory)


@cases(WRONG | ONLY_JOINT)
def test_audit_names_the_call(factory, call, reason):
    first = audit_drive(factory, DRIVE).first
    assert first.block == "exception"
    assert first.call in (call, "start", "predict 0")  # it asks for the belief more often
    with pytest.raises(FilterFailure, match=reason):
        raise FilterFailure(first.call, first.reason)


@cases({name: case for name, case in (WRONG | ONLY_JOINT).items() if name != "few at the end"})
def test_trace_names_a_call(factory, call, reason):  # noqa: ARG001
    with pytest.raises(FilterFailure, match=reason):
        trace(factory, Feed.of(DRIVE))


class Raw(EkfSlam):
    motion = "imu"


def test_filter_of_raw_samples_is_not_audited_on_twists():
    with pytest.raises(InputError, match=r"takes twists.*; this one asks for raw IMU samples"):
        audit_drive(Raw, DRIVE)
    assert gate.refuse_as_often_as_told(Raw, DRIVE).outcome == "skipped"


def test_beliefs_along_a_batch_axis_pass_and_others_do_not():
    w = np.random.default_rng(0).standard_normal((2, 3, DRIVE.scalars)) * 1e-3
    readings = DRIVE.realise(w)
    filter_ = Driven(EkfSlam, replace(DRIVE.task, prior=readings.prior))
    for done in filter_.feed(DRIVE.inputs(readings)):
        assert filter_.belief(done.name, joint=True).T_world_imu.shape == (2, 3, 4, 4)
    with pytest.raises(FilterFailure, match=r"left `T_world_imu` of shape \(2, 4, 4\)"):
        checked("finish", Belief(T_world_imu=np.tile(np.eye(4), (2, 1, 1))), batch=(3,))


SOURCE = """
from dataclasses import replace
import numpy as np
from vislam.filters import EkfSlam

class Foreign(EkfSlam):
    def belief(self, joint=False):
        belief = super().belief(joint)
        return replace(belief, ids=belief.ids + 10**6)

class Chart(EkfSlam):
    def belief(self, joint=False):
        return replace(super().belief(joint), chart="polar")

class Nan(EkfSlam):
    def belief(self, joint=False):
        belief = super().belief(joint)
        return replace(belief, landmark_covariances=belief.landmark_covariances * np.nan)
"""


@pytest.mark.parametrize("name", ["Foreign", "Chart", "Nan"])
@pytest.mark.parametrize("verb", ["audit", "run", "check"])
def test_wrong_filter_never_ends_in_an_internal_error(verb, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong_for_driving.py").write_text(SOURCE)
    (tmp_path / "short.yaml").write_text("name: short\nduration_s: 1.0\nrate_hz: 5.0\n")
    source = {"audit": [], "run": ["short.yaml"], "check": ["short.yaml", "--runs", "2"]}[verb]
    if verb == "check":
        source += ["--jobs", "1"]
    status = 0 if (verb, name) == ("run", "Foreign") else 1  # a run does not judge the map
    assert main([verb, *source, "--filter", f"wrong_for_driving:{name}"]) == status
    assert "Internal error" not in capsys.readouterr().err
