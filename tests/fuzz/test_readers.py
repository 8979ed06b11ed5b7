"""The readers under coverage-guided fuzzing for a bounded time; longer by hand: see the harness."""

from importlib.util import find_spec

import pytest

from tests.fuzz.harness import READERS, fuzz

SECONDS = 2


@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not there: the extra `fuzz`")
@pytest.mark.parametrize("reader", READERS)
def test_nothing_but_our_own_errors_comes_out_of_a_reader(tmp_path, reader, capsys):
    tried = fuzz(reader, SECONDS, tmp_path)
    with capsys.disabled():
        print(f"\n{reader}: {tried}")  # noqa: T201
    assert tried.inputs > 10
    assert tried.past_header > 0
