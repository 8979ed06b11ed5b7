"""The `.npy` that holds a pickled dict of arrays, read without unpickling.

A pickle is a program. `pickle` runs it, and even with every import refused a few bytes of it can
claim all memory (an index of the memo, a bytearray) or all time (tuples of tuples as a key). So
this module interprets the few instructions that an array, a number, a text or a plain container is
written with, by every protocol and numpy 1 and 2, and refuses all others by name.
"""

import pickletools
import re
import reprlib  # `repr` of lists in each other can take for ever
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simbench.errors import DatasetError
from simbench.files import reason, size_of
from simbench.limits import refuse_above_limit

Value: TypeAlias = NDArray[Any] | str | None

#: A dict of eight arrays takes two hundred instructions; a list, one for each number.
MAX_INSTRUCTIONS = 300_000
#: Of the file in memory: as bytes, and as float64.
COPIES = 2
#: Of an array: features have three.
MAX_AXES = 3

_MAGIC = b"\x93NUMPY"
#: Real numbers, truth values, and texts.
_DTYPE = re.compile(r"[biuf][1248]|U\d{1,6}|O8?")
_LITERALS = {"BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8", "INT", "BININT", "BININT1"}
_LITERALS |= {"BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT", "UNICODE", "BINUNICODE"}
_LITERALS |= {"SHORT_BINUNICODE", "BINUNICODE8"}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}


def load_npy_dict(path: Path) -> dict[str, Value]:
    """Read what ``np.save(path, {"v_t": array, ...})`` wrote.

    Numbers and nested lists of numbers come back as arrays too, texts and None as they are.
    Arrays are views of the bytes of the file, and cannot be written to.

    Raises:
        DatasetError: there is no such file, it holds something else or anything that is neither
            array nor plain container, it is damaged, or it claims more than the limit.
    """
    try:
        size = size_of(path)
        refuse_above_limit(str(path), "the file", COPIES * size)
        with path.open("rb") as file:
            _skip_header(path, file)
            content = _Machine(path, _Bounded(file, size)).run()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {reason(error)}.") from error
    content = _plain(content)
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: expected a dict of arrays, got {_kind(content)}.")
    return {key: _value(path, key, value) for key, value in content.items()}


def _skip_header(path: Path, file: IO[bytes]) -> None:
    """Step over the header of an array of one object."""
    head = file.read(8)
    if head[:6] != _MAGIC:
        raise DatasetError(f"{path}: expected a .npy file, got one that starts with {head[:6]!r}.")
    width = 2 if head[6:7] == b"\1" else 4
    header = file.read(min(int.from_bytes(file.read(width), "little"), 10_000))
    if not re.search(rb"'descr': *'\|O'", header) or not re.search(rb"'shape': *\(\)", header):
        raise DatasetError(
            f"{path}: expected a .npy file of one dict, as np.save(path, dict) writes it, got the "
            f"header {header.decode('latin-1').strip()!r:.120}."
        )


class _Bounded:
    """A stream that never asks its file for more than there is: a read allocates first."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._size = file, size
        self.tell = file.tell

    def read(self, n: int) -> bytes:
        return self._file.read(min(n, self._size - self._file.tell()))

    def readline(self) -> bytes:
        return self._file.readline()


class _Named(NamedTuple):
    """A function that the pickle names, one of `_FUNCTIONS`."""

    name: str


class _Dtype:
    """What stands for a dtype until its byte order is known."""

    def __init__(self, code: object, *_: object) -> None:
        if not isinstance(code, str) or not _DTYPE.fullmatch(code):
            raise ValueError(
                f"the dtype {reprlib.repr(code)}; only real numbers and texts are read"
            )
        self.code, self.order = code, "="

    def build(self, _: "_Machine", state: Any) -> None:
        order = state[1]
        if order not in ("<", ">", "|", "="):
            raise ValueError(f"the byte order {reprlib.repr(order)}")
        self.order = order

    def dtype(self) -> np.dtype[Any]:
        return np.dtype(self.order + self.code)


class _Array:
    """What stands for an array until its state is known."""

    value: Any = None

    def build(self, machine: "_Machine", state: Any) -> None:
        shape, dtype, fortran_order, data = state[-4:]
        self.value = machine.array(data, dtype, shape, "F" if fortran_order else "C")


class _Machine:
    """Runs the instructions of a pickle that are admitted."""

    def __init__(self, path: Path, stream: _Bounded) -> None:
        self._path, self._stream = path, stream
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        self._copied_bytes = 0

    def run(self) -> Any:
        """The object that the pickle describes."""
        try:
            # it is typed for files, and uses `read` and `readline` of one
            instructions = pickletools.genops(self._stream)  # type: ignore[arg-type]
            for count, (instruction, argument, _) in enumerate(instructions):
                if count > MAX_INSTRUCTIONS:
                    raise ValueError(
                        f"more than {MAX_INSTRUCTIONS} values; save arrays, not lists of numbers"
                    )
                self._do(instruction.name, argument)
            return self._stack.pop()
        except (
            ValueError,
            TypeError,
            IndexError,
            KeyError,
            AttributeError,
            OverflowError,
        ) as error:
            said = error if isinstance(error, ValueError) else "its instructions make no sense"
            raise DatasetError(f"{self._path}: the pickled dict cannot be read: {said}.") from error

    def array(self, data: Any, dtype: Any, shape: Any, order: Any) -> Any:
        """An array on bytes that are there already; of an array of one object, the object."""
        if dtype.code.startswith("O"):
            if shape != ():
                raise ValueError(
                    f"an array of objects of shape {reprlib.repr(shape)}; save numbers"
                )
            (value,) = data
            return value
        held = dtype.dtype()
        if len(shape) > MAX_AXES or not all(type(n) is int and 0 <= n < 2**48 for n in shape):
            raise ValueError(f"the shape {reprlib.repr(shape)}")
        if prod(shape) * held.itemsize != len(data):
            raise ValueError(
                f"expected shape {reprlib.repr(shape)} of {held}, got {len(data)} bytes"
            )
        return np.frombuffer(bytes(data) if isinstance(data, bytearray) else data, held).reshape(
            shape, order="F" if order == "F" else "C"
        )

    def encode(self, text: str, encoding: str) -> bytes:
        """Bytes as protocols before 3 write them."""
        if encoding not in ("latin1", "latin-1"):
            raise ValueError(f"bytes as text in {reprlib.repr(encoding)}")
        self._copied_bytes += len(text)
        refuse_above_limit(str(self._path), "the pickled dict", self._copied_bytes)
        return text.encode("latin1")

    def _do(self, name: str, argument: Any) -> None:
        stack = self._stack
        match name:
            case _ if name in _LITERALS:
                stack.append(argument)
            case _ if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case "PROTO" | "FRAME" | "STOP":
                pass
            case "MARK":
                self._marks.append(len(stack))
            case "EMPTY_LIST" | "EMPTY_DICT" | "EMPTY_TUPLE":
                stack.append({"EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple}[name]())
            case "LIST" | "TUPLE":
                stack.append((list if name == "LIST" else tuple)(self._since_mark()))
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                stack[-int(name[-1]) :] = [tuple(stack[-int(name[-1]) :])]
            case "DICT":
                items = self._since_mark()
                stack.append({})
                self._set_items(items)
            case "APPEND" | "APPENDS":
                items = [stack.pop()] if name == "APPEND" else self._since_mark()
                _of(list, stack[-1]).extend(items)
            case "SETITEM" | "SETITEMS":
                items = [stack.pop(-2), stack.pop()] if name == "SETITEM" else self._since_mark()
                self._set_items(items)
            case "MEMOIZE":
                self._memo[len(self._memo)] = stack[-1]
            case "PUT" | "BINPUT" | "LONG_BINPUT":
                self._memo[argument] = stack[-1]
            case "GET" | "BINGET" | "LONG_BINGET":
                stack.append(self._memo[argument])
            case "GLOBAL" | "INST":
                stack.append(_named(*argument.split(" ", 1)))
            case "STACK_GLOBAL":
                function = stack.pop()
                stack[-1] = _named(stack[-1], function)
            case "REDUCE":
                arguments = _of(tuple, stack.pop())
                stack[-1] = _FUNCTIONS[_of(_Named, stack[-1]).name](self, *arguments)
            case "BUILD":
                state = stack.pop()
                stack[-1].build(self, state)
            case _:
                raise ValueError(
                    f"it holds the instruction {name}; only arrays and plain containers are read"
                )

    def _since_mark(self) -> list[Any]:
        mark = self._marks.pop()
        items = self._stack[mark:]
        del self._stack[mark:]
        return items

    def _set_items(self, items: list[Any]) -> None:
        for key in items[::2]:
            if not isinstance(key, str):
                raise ValueError(f"expected texts as keys, got {_kind(key)}")
        _of(dict, self._stack[-1]).update(zip(items[::2], items[1::2], strict=True))


def _scalar(machine: _Machine, dtype: _Dtype, data: Any) -> Any:
    return machine.array(data, dtype, (), "C")


#: What an array is made with, by the last part of its name in numpy; each takes the machine first.
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "_reconstruct": lambda _, *arguments: _Array(),  # noqa: ARG005
    "dtype": lambda _, *arguments: _Dtype(*arguments),
    "scalar": _scalar,
    "_frombuffer": _Machine.array,
    "encode": _Machine.encode,
}
_ADMITTED = {
    "numpy": {"dtype", "ndarray"},
    "numpy.core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy.core.numeric": {"_frombuffer"},
    "numpy._core.numeric": {"_frombuffer"},
    "_codecs": {"encode"},
}


def _named(module: object, name: object) -> _Named:
    if not isinstance(module, str) or name not in _ADMITTED.get(module, ()):
        raise ValueError(
            f"it asks for {module}.{name}, which is no array; only arrays and plain containers "
            "are read, and nothing was run"
        )
    return _Named(str(name))


def _of(kind: type, value: Any) -> Any:
    if not isinstance(value, kind):
        raise TypeError(kind)
    return value


def _plain(value: Any) -> Any:
    """What a stand-in stands for."""
    return value.value if isinstance(value, _Array) else value


def _value(path: Path, key: str, value: Any) -> Value:
    """A value as an array, or the text or nothing that it is."""
    value = _plain(value)
    if value is None or isinstance(value, str | np.ndarray):
        return value
    shape: list[int] = []
    inner = value
    while isinstance(inner, list | tuple) and len(shape) <= MAX_AXES:
        shape.append(len(inner))
        inner = _plain(inner[0]) if inner else 0.0
    if len(shape) > MAX_AXES or prod(shape) > MAX_INSTRUCTIONS:
        raise DatasetError(
            f"{path}: {key}: expected an array, got nested lists of shape {tuple(shape)}."
        )
    numbers: list[float] = []
    try:
        _flatten(value, shape, numbers)
        return np.array(numbers, float).reshape(shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise DatasetError(
            f"{path}: {key}: expected an array of numbers, got {_kind(value)} of other things."
        ) from error


def _flatten(value: Any, shape: list[int], numbers: list[float]) -> None:
    """Gather the numbers of nested lists that are of one shape all over."""
    if not shape:
        value = _plain(value)
        value = value.item() if isinstance(value, np.ndarray) else value
        if not isinstance(value, int | float):
            raise TypeError(value)
        numbers.append(float(value))
    elif len(value) != shape[0]:
        raise ValueError(len(value))
    else:
        for item in value:
            _flatten(item, shape[1:], numbers)


def _kind(value: object) -> str:
    return "nothing" if value is None else f"a {type(value).__name__}"
