"""Writing files so that none is ever seen half-written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simbench.errors import OutputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, and put it in place of `path` once the block succeeded.

    The temporary path is `path` with ``.partial`` behind it. Where the block fails it is removed and
    what stood at `path` before is untouched.

    Raises:
        OutputError: the operating system refused; says what and why.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(
            f"Cannot write {path}: {error.strerror or error}. Free space or choose another --out; "
            "earlier files are untouched."
        ) from error
    finally:
        partial.unlink(missing_ok=True)
