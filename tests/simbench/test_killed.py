"""Killed at any moment, without room, without rights, or two at once: nothing whole is harmed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from simbench.errors import DatasetError, OutputError
from simbench.files import replacing
from simbench.mcap import container, read_dataset_mcap, summary
from simbench.npz import read_npz

SCENE = "duration_s: 12\nlandmarks: {count: 40}\nimu: {raw: {rate_hz: 50}}\n"
#: The verbs, and the last file that each writes.
VERBS = {
    "generate": (["generate", "s.yaml"], "s.mcap"),
    "run": (["run", "s.yaml", "--filter", "slam"], "s.slam.consistency.png"),
    "convert": (["convert", "s.mcap", "out/s.npz"], "s.npz"),
}
ENVIRONMENT = os.environ | {"OPENBLAS_NUM_THREADS": "1"}


def command(arguments):
    out = [] if arguments[0] == "convert" else ["--out", "out"]
    return [sys.executable, "-c", "from simbench.cli import main; main()", *arguments, *out]


def started(directory, arguments):
    return subprocess.Popen(
        command(arguments),
        cwd=directory,
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A directory in which every verb has run, and the seconds of each."""
    directory = tmp_path_factory.mktemp("whole")
    (directory / "s.yaml").write_text(SCENE)
    seconds = {}
    for verb, (arguments, last) in VERBS.items():
        start = time.monotonic()
        assert started(directory, arguments).wait() == 0
        seconds[verb] = time.monotonic() - start
        assert (directory / "out" / last).is_file()
        if verb == "generate":
            shutil.copy(directory / "out" / "s.mcap", directory / "s.mcap")
    return directory, seconds


def killed(whole, directory, verb, moment):
    """Kill a verb that writes where whole files stand already; what stands there afterwards.

    Args:
        whole: the directory with the whole files.
        directory: an empty one.
        verb: of `VERBS`.
        moment: called with the directory and the process; returns when to kill.
    """
    shutil.copytree(whole, directory)
    process = started(directory, VERBS[verb][0])
    try:
        moment(directory, process)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    for path in sorted(whole.rglob("*.*")):
        # Equal inputs give equal bytes: what is there is whole, be it of the first run or this one.
        again = directory / path.relative_to(whole)
        if path.suffix == ".json":
            assert json.loads(again.read_text()).keys() == json.loads(path.read_text()).keys()
        else:
            assert again.read_bytes() == path.read_bytes(), path
    left = {path.name for path in directory.rglob("*.*")} - {p.name for p in whole.rglob("*.*")}
    assert len(left) <= 1
    assert all(name.endswith(".partial") for name in left)
    return [directory / "out" / name for name in left]


def check_partial(partial, whole):
    """Hold a partial recording against the whole one; whether it held any frame."""
    original = whole / "out" / partial.name.removesuffix(".partial")
    try:
        found = summary(partial)
        dataset = read_dataset_mcap(partial)
    except DatasetError as error:
        # killed before the first frame was on the disk
        if "expected an MCAP file" not in str(error) and "ends before any" not in str(error):
            raise
        return False
    assert not found.finished
    expected = read_dataset_mcap(original)
    assert 1 <= len(dataset) <= len(expected)
    np.testing.assert_array_equal(dataset.times_s, expected.times_s[: len(dataset)])
    np.testing.assert_array_equal(dataset.linear_velocity, expected.linear_velocity[: len(dataset)])
    finished = partial.with_name("finished.mcap")
    container.finish(partial, finished)
    again = read_dataset_mcap(finished)
    np.testing.assert_array_equal(again.times_s, dataset.times_s)
    assert "unfinished" in again.notes[-1]
    assert summary(finished).finished
    return True


def after(share, seconds):
    """A moment: this share of the verb's whole time."""

    def wait(_, process):
        with suppress(subprocess.TimeoutExpired):
            process.wait(share * seconds)

    return wait


def while_writing(name, share):
    """A moment: when the partial file of this name has grown to a share of the whole one."""

    def wait(directory, process):
        partial = directory / "out" / f"{name}.partial"
        size = share * (directory / "out" / name).stat().st_size
        while process.poll() is None:
            try:
                if partial.stat().st_size >= size:
                    return
            except FileNotFoundError:
                pass
            time.sleep(0.0005)
        pytest.fail(f"{partial.name} never had {size:.0f} bytes, status {process.returncode}")

    return wait


def kill_and_check(whole, tmp_path, moments):
    directory, _ = whole
    readable = 0
    for i, (verb, moment) in enumerate(moments):
        for partial in killed(directory, tmp_path / str(i), verb, moment):
            if ".mcap" in partial.name:
                readable += check_partial(partial, directory)
        shutil.rmtree(tmp_path / str(i))
    return readable


def test_a_killed_verb_harms_no_file_and_leaves_a_readable_recording(whole, tmp_path):
    _, seconds = whole
    moments = [("run", after(0.7, seconds["run"])), ("convert", after(0.8, seconds["convert"]))]
    moments += [("run", while_writing("s.slam.mcap", 0.5))]
    moments += [("generate", while_writing("s.mcap", 0.5))]
    assert kill_and_check(whole, tmp_path, moments) >= 2


@pytest.mark.slow
def test_fifty_five_kills_over_the_whole_of_each_verb_and_while_writing(whole, tmp_path):
    _, seconds = whole
    moments = [
        (verb, after(share, seconds[verb])) for verb in VERBS for share in np.linspace(0.05, 1, 15)
    ]
    moments += [("run", while_writing("s.slam.mcap", share)) for share in np.linspace(0, 0.8, 6)]
    moments += [("generate", while_writing("s.mcap", share)) for share in (0.1, 0.4, 0.8)]
    moments += [("generate", while_writing("s.npz", 0))]
    assert len(moments) >= 55
    assert kill_and_check(whole, tmp_path, moments) >= 4


def test_the_next_run_replaces_what_a_killed_one_left(tmp_path):
    (tmp_path / "a.txt.partial").write_text("left by a killed run, longer than what comes")
    with replacing(tmp_path / "a.txt") as partial:
        partial.write_text("new")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.txt", "new")]


def test_a_second_writer_is_told_so_and_harms_neither(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("earlier")
    with replacing(path) as partial:
        partial.write_text("first")
        with pytest.raises(OutputError, match=r"another process is writing it"), replacing(path):
            pytest.fail("both write")
        assert path.read_text() == "earlier"
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.txt", "first")]


RACE = """
import sys
from pathlib import Path
from simbench.errors import OutputError
from simbench.files import replacing
letter, done = sys.argv[2].encode(), 0
for _ in range(300):
    try:
        with replacing(Path(sys.argv[1])) as partial, partial.open("wb") as file:
            for _ in range(20):
                file.write(letter * 5000)
                file.flush()
        done += 1
    except OutputError as error:
        assert "another process is writing it" in str(error), error
print(done)
"""


def test_two_processes_writing_one_file_never_mix(tmp_path):
    path = tmp_path / "a"
    writers = [
        subprocess.Popen([sys.executable, "-c", RACE, path, c], stdout=subprocess.PIPE)
        for c in "xy"
    ]
    seen = set()
    while any(writer.poll() is None for writer in writers):
        if path.exists():
            content = path.read_bytes()
            assert len(content) == 100_000
            assert len(set(content)) == 1
            seen.add(content[:1])
    assert all(int(writer.communicate()[0]) > 0 and writer.returncode == 0 for writer in writers)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
def test_two_runs_to_one_place_end_in_one_result_and_one_message(whole, tmp_path):
    directory = tmp_path / "two"
    shutil.copytree(whole[0], directory)
    arguments = VERBS["run"][0]
    first = started(directory, arguments)
    try:
        while_writing("s.slam.mcap", 0)(directory, first)
        first.send_signal(signal.SIGSTOP)
        second = subprocess.run(
            command(arguments),
            cwd=directory,
            env=ENVIRONMENT,
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        first.send_signal(signal.SIGCONT)
    assert "s.slam.mcap: another process is writing it" in second.stderr
    assert "Traceback" not in second.stderr
    assert first.wait() == 0
    name = "out/s.slam.mcap"
    assert (directory / name).read_bytes() == (whole[0] / name).read_bytes()


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
from simbench.cli import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize(
    ("verb", "size"),
    [
        ("generate", 1000),
        ("generate", 100_000),
        ("run", 100_000),
        ("convert", 1000),
        pytest.param("run", 1000, marks=pytest.mark.slow),
    ],
)
def test_no_room_for_a_file_is_one_message_and_earlier_files_stay(whole, tmp_path, verb, size):
    directory = tmp_path / "full"
    shutil.copytree(whole[0], directory)
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(size), *command(VERBS[verb][0])[3:]],
        cwd=directory,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "Cannot write out/" in done.stderr
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr
    unchanged(whole[0], directory)


def unchanged(whole, directory):
    names = sorted(path.relative_to(whole) for path in whole.rglob("*.*"))
    assert sorted(path.relative_to(directory) for path in directory.rglob("*.*")) == names
    for name in names:
        if name.suffix != ".json":
            assert (directory / name).read_bytes() == (whole / name).read_bytes()


@pytest.fixture
def small_disk(tmp_path):
    """A file system of its own, of 200 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", place],
        capture_output=True,
        check=False,
    )
    if done.returncode:
        pytest.skip("only root can mount a small disk")
    yield place
    subprocess.run(["umount", place], check=True)


@pytest.mark.parametrize("verb", ["generate", pytest.param("run", marks=pytest.mark.slow)])
def test_a_full_disk_is_one_message_and_earlier_files_stay(small_disk, verb):
    (small_disk / "s.yaml").write_text(SCENE)
    (small_disk / "out").mkdir()
    (small_disk / "out" / VERBS[verb][1]).write_text("earlier")
    done = subprocess.run(
        command(VERBS[verb][0]),
        cwd=small_disk,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr
    assert (small_disk / "out" / VERBS[verb][1]).read_text() == "earlier"
    assert not list(small_disk.rglob("*.partial"))


def test_a_directory_that_cannot_be_written_is_one_message(tmp_path):
    place = tmp_path / "fixed"
    place.mkdir(mode=0o555)
    try:
        (place / "x").touch()
        (place / "x").unlink()
        place = Path("/proc/nothing")  # root may write anywhere else
    except PermissionError:
        pass
    with (
        pytest.raises(OutputError, match=r"^Cannot write .*Choose another directory"),
        replacing(place / "a.txt"),
    ):
        pytest.fail("it can be written")


def test_a_directory_that_vanishes_in_between_is_one_message(tmp_path):
    place = tmp_path / "out"

    def write():
        with replacing(place / "a.txt") as partial:
            partial.write_text("x")
            shutil.rmtree(place)

    with pytest.raises(OutputError, match=r"Cannot write .*No such file or directory"):
        write()


def test_files_that_vanish_or_shrink_while_they_are_read_are_one_message(whole, tmp_path):
    npz, mcap = tmp_path / "s.npz", tmp_path / "s.mcap"
    contents = {path: (whole[0] / "out" / path.name).read_bytes() for path in (npz, mcap)}
    stop = threading.Event()

    def disturb():
        rng = np.random.default_rng(1)
        while not stop.is_set():
            for path, content in contents.items():
                path.write_bytes(content[: rng.integers(len(content) + 1)])
                time.sleep(0.001)
                path.unlink()
                path.write_bytes(content)
                time.sleep(0.001)

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        for _ in range(15):
            for path, read in ((npz, read_npz), (mcap, summary)):
                try:
                    read(path)
                except DatasetError as error:
                    assert str(error).startswith(str(path))  # noqa: PT017
    finally:
        stop.set()
        thread.join()
