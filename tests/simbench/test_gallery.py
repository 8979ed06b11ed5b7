"""The pictures that the README shows are those of one command."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simbench import figures, gallery
from tests.simbench.records import circle

ROOT = Path(__file__).parents[2]


def test_the_readme_shows_every_picture_and_each_is_small():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"\]\(scenarios/(\w+)\.png\)", readme))
    assert shown == set(gallery.GALLERY)
    for name in shown:
        path = ROOT / "scenarios" / f"{name}.png"
        assert path.stat().st_size < 120_000, name
        with Image.open(path) as picture:
            assert picture.width > 1000


def test_a_small_picture_looks_as_the_large_one_does(tmp_path):
    for name, save in (("large", figures.save), ("small", gallery.save)):  # a second draw differs
        save(figures.trajectories([circle().record]), tmp_path / f"{name}.png")
    sizes = [(tmp_path / f"{name}.png").stat().st_size for name in ("small", "large")]
    assert sizes[0] < 0.5 * sizes[1]
    small, large = (
        np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB"), float)
        for name in ("small", "large")
    )
    assert np.abs(small - large).mean() < 0.2


def test_figure8_shows_the_papers_three_estimators(monkeypatch):
    monkeypatch.chdir(ROOT)
    titles = [ax.get_title().split(",")[0] for ax in gallery.figure8().axes]
    assert titles == ["dead-reckoning", "mapping", "slam"]


@pytest.mark.parametrize("name", gallery.CONSISTENT)
def test_every_filter_of_the_gallery_is_there(name):
    from simbench.filters import known

    assert name in known()
