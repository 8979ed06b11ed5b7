"""What a filter's name means."""

from importlib.metadata import EntryPoint

import pytest

from simbench import filters
from simbench.errors import InputError
from simbench.filters import FILTERS, known, resolve
from vislam.filters import EkfSlam, Mapping


@pytest.mark.parametrize("name", FILTERS)
def test_each_of_ours_is_a_factory(name):
    assert callable(resolve(name))


def test_a_name_means_what_it_says():
    assert resolve("slam") is EkfSlam
    assert resolve("mapping-truth") == Mapping.on_truth
    assert resolve("slam-fej").func is EkfSlam


def test_a_factory_of_the_working_directory_is_found(tmp_path, monkeypatch):
    (tmp_path / "my_own_filter.py").write_text("class Mine: pass\nmake = Mine\nnumber = 3\n")
    monkeypatch.chdir(tmp_path)
    assert resolve("my_own_filter:make").__name__ == "Mine"
    with pytest.raises(InputError, match=r"takes a vislam\.types\.Task .*got int"):
        resolve("my_own_filter:number")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("slamm", "Did you mean slam"),
        ("qqq", "There are dead-reckoning, mapping"),
        ("no.such.module:factory", "ModuleNotFoundError"),
        ("vislam.filters:Nothing", "AttributeError"),
    ],
)
def test_a_name_that_means_nothing_is_said_to(name, said):
    with pytest.raises(InputError, match=said):
        resolve(name)


def test_another_distribution_registers_a_name(monkeypatch):
    point = EntryPoint("theirs", "vislam.filters:DeadReckoning", filters.GROUP)
    monkeypatch.setattr(filters, "entry_points", lambda group: [point] * (group == filters.GROUP))
    assert known()["theirs"] == "registered as vislam.filters:DeadReckoning"
    assert resolve("theirs").__name__ == "DeadReckoning"
