"""The pictures of the features, decoded by Pillow, against the frames that they show."""

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from simbench.dataset import Sightings
from simbench.mcap import pictures
from simbench.mcap.pictures import Fate, draw, fates, size_px
from tests.simbench.recordings import EPOCH_NS, Truthful, drive, messages, record_drive
from vislam.camera import StereoRig
from vislam.types import Innovation, StereoFrame

COLOURS = {
    "background": (20, 20, 24),
    Fate.UNTESTED: (235, 235, 235),
    Fate.USED: (60, 210, 90),
    Fate.REFUSED: (255, 70, 60),
}


def decoded(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def drawn(pixels, fate, size=(40, 30)):
    return decoded(draw(np.array(pixels, float), np.array(fate), size))


@pytest.mark.parametrize("fate", Fate)
def test_feature_is_a_square_of_its_colour_about_its_pixel(fate):
    picture = drawn([(10.4, 20.6)], [fate])
    assert picture.shape == (30, 40, 3)
    coloured = (picture != COLOURS["background"]).any(axis=-1)
    rows, columns = np.nonzero(coloured)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (18, 24, 7, 13)
    assert coloured.sum() == 49
    assert {tuple(colour) for colour in picture[coloured]} == {COLOURS[fate]}


COORDINATE = st.floats(-60, 60) | st.floats(allow_nan=False, allow_infinity=False)


@given(st.tuples(COORDINATE, COORDINATE).filter(lambda pixel: -1 not in pixel))
def test_feature_is_cut_off_at_the_edge_wherever_it_lies(pixel):
    coloured = (drawn([pixel], [Fate.USED]) != COLOURS["background"]).any(axis=-1)
    columns, rows = (
        [abs(k - round(at)) <= 3 for k in range(size)]
        for at, size in zip(pixel, (40, 30), strict=True)
    )
    np.testing.assert_array_equal(coloured, np.outer(rows, columns))


def test_what_a_camera_does_not_see_is_not_drawn():
    assert (drawn([(-1, -1), (-1, 5)], [Fate.USED] * 2) == COLOURS["background"]).all()
    assert (drawn(np.empty((0, 2)), []) == COLOURS["background"]).all()


def test_fate_is_what_the_innovation_says():
    frame = StereoFrame(
        time_s=0.0, ids=np.arange(5), pixels=np.ones((5, 4)), last=np.zeros(5, bool)
    )
    innovation = Innovation(
        ids=np.array([1, 3]),
        residual=np.zeros((2, 4)),
        whitened=np.zeros((2, 4)),
        accepted=np.array([True, False]),
        born=np.array([0]),
        skipped=np.array([4]),
    )
    expected = [Fate.UNTESTED, Fate.USED, Fate.UNTESTED, Fate.REFUSED, Fate.REFUSED]
    assert fates(frame, innovation).tolist() == expected
    assert fates(frame, None).tolist() == [Fate.UNTESTED] * 5


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "p.mcap"
    dataset = drive()
    return dataset, record_drive(path, dataset), messages(path)


def test_each_picture_shows_its_frame_from_its_camera(made):
    dataset, record, topics = made
    stamps = (EPOCH_NS + dataset.times_ns).tolist()
    for i in (0, 1):
        received = topics[f"/cam{i}/image/compressed"]
        assert [ns for ns, _ in received] == stamps
        for frame, (_, message) in enumerate(received):
            assert (message.format, message.header.frame_id) == ("png", f"cam{i}")
            picture = decoded(message.data.tobytes())
            assert picture.shape == (376, 1242, 3)
            pixels = dataset.frame(frame).pixels[:, 2 * i : 2 * i + 2]
            seen = pixels[(pixels != -1).all(axis=-1)]
            u, v = np.rint(seen).astype(int).T
            tested = record.steps[frame].innovation.ids
            assert len(tested) == len(pixels)
            assert (picture[v, u] == COLOURS[Fate.USED]).all()
            assert (picture != COLOURS["background"]).any(axis=-1).sum() <= 49 * len(seen)


def test_there_are_at_most_twenty_pictures_a_second(tmp_path):
    fast = replace(drive(100), times_s=0.01 * np.arange(100), imu=None)
    record_drive(tmp_path / "f.mcap", fast, Truthful)
    topics = messages(tmp_path / "f.mcap")
    assert len(topics["/stereo/features"]) == 100
    times = [ns for ns, _ in topics["/cam1/image/compressed"]]
    assert np.diff(times).tolist() == [50_000_000] * 19


def test_size_is_the_images_or_holds_the_features():
    dataset = drive(3)
    assert size_px(dataset) == (1242, 376)
    rig = StereoRig(fx_px=1.0, fy_px=1.0, cx_px=0.0, cy_px=0.0, baseline_m=1.0)
    unknown = replace(dataset, calibration=replace(dataset.calibration, rig=rig))

    def size_of(*pixels):
        rows = [(np.array([0]), np.array([pixels]))] if pixels else []
        return size_px(replace(unknown, sightings=Sightings.from_frames(rows)))

    assert size_of(7.2, 3.0, -1.0, -1.0) == (9, 4)
    assert size_of(7.2, 3.0, 1e300, 3.5) == (pictures.MOST_PX, 5)
    assert size_of() == (0, 0)
    assert size_px(replace(unknown, sightings=None)) == (0, 0)


@pytest.mark.parametrize("image_px", [None, (1242, 376), (10**6, 10**6)])
def test_without_features_or_a_usual_size_there_are_no_pictures(tmp_path, image_px):
    dataset = drive(3)
    rig = replace(dataset.calibration.rig, image_px=image_px)
    told = replace(dataset, calibration=replace(dataset.calibration, rig=rig))
    usual = image_px == (1242, 376)
    record_drive(tmp_path / "n.mcap", replace(told, sightings=None) if usual else told)
    topics = messages(tmp_path / "n.mcap")
    assert ("/cam0/image/compressed" in topics) == (image_px is None)
    assert topics["/cam0/camera_info"][0][1].width == (image_px or size_px(told))[0]
