"""A recording says how it was made, and is made again from itself, to the last byte."""

import json
import platform
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType

import pytest

from simbench import __version__
from simbench.cli import main
from simbench.errors import InputError
from simbench.mcap import record_to, summary
from simbench.outputs import filter_of, options_of
from simbench.run import RunOptions
from tests.simbench import drives as real
from tests.simbench.drives import with_jumps, with_repeats
from tests.simbench.recordings import drive

SCENE = """
name: short
duration_s: 2.0
rate_hz: 10.0
landmarks: {kind: box, count: 30}
imu: {raw: {rate_hz: 50.0}}
filter: {gate: 0.99}
"""


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The recording of a run whose scene, seed, run, filter and gate are none of the defaults."""
    directory = tmp_path_factory.mktemp("first")
    (directory / "short.yaml").write_text(SCENE)
    told = ["--seed", "5", "--run", "2", "--set", "rate_hz=20.0", "--gate", "0.95"]
    past = ["--smooth", "--memory", "1GB", "--retire-after", "4"]
    arguments = ["--filter", "slam-fej", *told, *past, "--out", str(directory)]
    assert main(["run", str(directory / "short.yaml"), *arguments]) == 0
    return directory / "short.slam-fej.mcap"


def without_wall_clock(path: Path) -> dict[str, object]:
    values = json.loads(path.read_text())
    return {k: v for k, v in values.items() if k not in ("wall_s", "realtime_factor")}


def test_run_of_a_recording_repeats_it_to_the_last_byte(first, tmp_path, capsys):
    (first.parent / "short.yaml").unlink()  # a recording needs nothing beside itself
    assert main(["run", str(first), "--out", str(tmp_path)]) == 0
    assert summary(first).counts["/smoothed/pose"] == 41
    assert "short.slam-fej.mcap" in capsys.readouterr().out
    for suffix in (".mcap", ".tum"):
        again = tmp_path / first.with_suffix(suffix).name
        assert again.read_bytes() == first.with_suffix(suffix).read_bytes()
    again = tmp_path / first.with_suffix(".json").name
    assert without_wall_clock(again) == without_wall_clock(first.with_suffix(".json"))


def test_the_run_of_a_real_drive_is_repeated_on_what_its_filter_was_fed(tmp_path, capsys):
    """Its repeats and jumps were left out; looking for more would leave out others."""
    data = with_jumps(with_repeats(real.drive(0.1, 0.05, 0.7, seconds=5.0, seed=1)), share=0.05)
    path = real.write_bare(tmp_path / "d.npz", data, "2022")
    out = [tmp_path / "first", tmp_path / "again"]
    assert main(["run", str(path), "--filter", "slam", "--out", str(out[0])]) == 0
    assert "jump for one frame" in capsys.readouterr().err
    again = ["run", str(out[0] / "d.slam.mcap"), "--out", str(out[1])]
    assert main(again) == 0
    first, second = (directory / "d.slam.tum" for directory in out)
    assert first.read_bytes() == second.read_bytes()


def test_recording_says_how_it_was_made(first):
    made_by = summary(first).metadata
    assert (
        made_by
        | {
            "scenario": "short",
            "seed": "5",
            "run": "2",
            "filter": "slam-fej",
            "gate": "0.95",
            "options": '{"inverse_depth": false, "memory_bytes": 1073741824, '
            '"retire_after": 4, "smooth": true}',
            "version": __version__,
            "origin_version": __version__,
            "python": platform.python_version(),
            "numpy": version("numpy"),
            "scipy": version("scipy"),
            "rosbags": version("rosbags"),
            "mcap": version("mcap"),
            "pillow": version("pillow"),
        }
        == made_by
    )


def recorded(path, name, options=MappingProxyType({})):
    with record_to(path, drive(1), name, options) as recorder:
        recorder.frame(0)
    return path


def test_options_of_a_recording_are_those_it_was_made_with(tmp_path):
    options = RunOptions(smooth=True, retire_after=3)
    assert options_of(recorded(tmp_path / "r.mcap", "slam", asdict(options))) == options
    assert options_of(recorded(tmp_path / "n.mcap", "slam")) is None
    assert options_of(recorded(tmp_path / "l.mcap", "slam", {"later": 1})) == RunOptions()


@pytest.mark.parametrize("options", [{"smooth": "perhaps"}, {"memory_bytes": None}])
def test_options_that_are_none_are_one_clear_error(tmp_path, options):
    with pytest.raises(InputError, match="expected the options of a run, got"):
        options_of(recorded(tmp_path / "r.mcap", "slam", options))


@pytest.mark.parametrize(
    ("recorded_name", "taken"), [(None, "slam"), ("mapping", "mapping"), ("slam+b", "slam+b")]
)
def test_filter_of_a_recording_is_the_one_that_made_it(tmp_path, recorded_name, taken):
    assert filter_of(recorded(tmp_path / "r.mcap", recorded_name)) == taken


def test_filter_of_any_other_source_is_slam(tmp_path):
    (tmp_path / "s.yaml").write_text(SCENE)
    assert filter_of(tmp_path / "s.yaml") == "slam"


def test_recording_does_not_start_code_from_outside_by_itself(tmp_path):
    (tmp_path / "evil.py").write_text("raise SystemExit('started')\n")
    path = recorded(tmp_path / "r.mcap", "evil:Filter")
    with pytest.raises(InputError, match=r"does not start by itself.*--filter evil:Filter"):
        filter_of(path)


def test_another_filter_may_be_named(first, tmp_path):
    assert main(["run", str(first), "--filter", "dead-reckoning", "--out", str(tmp_path)]) == 0
    assert summary(tmp_path / "short.dead-reckoning.mcap").metadata["filter"] == "dead-reckoning"
