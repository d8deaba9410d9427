"""Reads pickles of numbers, strings, containers and NumPy arrays without running anything in them."""

import io
import pickle
from typing import Any, ClassVar, cast

import numpy as np

from envs.core.errors import DatasetError

_REFUSED_OPCODES = b"PQio\x81\x82\x83\x84\x8f\x90\x91\x92\x97\x98"  # objects, sets, references to outside
_MAX_ITEMS = 1 << 28  # of all containers; a shared one counts wherever it is held
_CONTAINERS = (list, tuple, dict)
_LEAVES = (str, bytes, int, float, type(None), np.ndarray, np.generic)


class _Dict(dict):
    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(key, tuple):  # the hash of shared tuples in shared tuples may take years
            raise pickle.UnpicklingError("it has a tuple as a key")
        super().__setitem__(key, value)


class _DType:  # in place of numpy.dtype, whose state can turn bytes into pointers
    def __init__(self, code: str, *_: Any) -> None:
        self.value = np.dtype(code)
        if self.value.kind not in "biufcSU" or self.value.fields or self.value.subdtype:
            raise pickle.UnpicklingError(f"it has an array of '{code}'")


class _Unpickler(pickle._Unpickler):  # the Python one: that in C reserves memory before it checks lengths
    stack: list[Any]

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data), encoding="latin-1")
        self.bytes_left = len(data)
        self.names: dict[str, Any] = {
            "numpy.ndarray": None,
            "numpy.dtype": _DType,
            "__builtin__.bytes": lambda: b"",
        }
        self.names["_codecs.encode"] = lambda text, _: str.encode(text, "latin-1")
        for core in ("numpy.core", "numpy._core"):
            self.names[f"{core}.multiarray._reconstruct"] = lambda *_: np.empty(0, np.int8)
            self.names[f"{core}.multiarray.scalar"] = lambda dtype, data: self.array(data, dtype, 1)[0]
            self.names[f"{core}.numeric._frombuffer"] = self.array

    def find_class(self, module: str, name: str) -> Any:
        if f"{module}.{name}" not in self.names:
            raise pickle.UnpicklingError(f"it names '{module}.{name}'")
        return self.names[f"{module}.{name}"]

    def array(self, data: bytes, dtype: _DType, shape: Any, order: str = "C") -> np.ndarray:
        self.bytes_left -= len(data)
        if self.bytes_left < 0:
            raise pickle.UnpicklingError("its arrays are larger than the file")
        return np.frombuffer(data, dtype.value).reshape(shape, order="F" if order == "F" else "C").copy()

    def set_state(self) -> None:
        state: Any = self.stack.pop()
        target = self.stack[-1]
        if type(target) is _DType:
            target.value = target.value.newbyteorder(state[1])
        elif type(target) is np.ndarray:
            array = self.array(state[4], state[2], state[1], "F" if state[3] else "C")
            target.__setstate__(cast(Any, array.__reduce__()[2]))
        else:
            raise pickle.UnpicklingError(f"it sets the state of a {type(target).__name__}")

    dispatch: ClassVar[dict[int, Any]] = {
        code: load for code, load in pickle._Unpickler.dispatch.items() if code not in _REFUSED_OPCODES
    }
    dispatch[pickle.BUILD[0]] = set_state
    dispatch[pickle.BYTEARRAY8[0]] = dispatch[pickle.BINBYTES8[0]]
    dispatch[pickle.EMPTY_DICT[0]] = lambda self: self.append(_Dict())
    dispatch[pickle.DICT[0]] = lambda self: (self.pop_mark(), self.append(_Dict()))  # always written empty


def _count(value: Any, counts: dict[int, int]) -> int:
    """Counts what a value holds, and checks the types."""
    if not isinstance(value, _CONTAINERS):
        if isinstance(value, _LEAVES):
            return 1
        raise pickle.UnpicklingError(f"it holds a {type(value).__name__}")
    if id(value) not in counts:
        counts[id(value)] = _MAX_ITEMS  # what a container that holds itself counts
        items = value.values() if isinstance(value, dict) else value
        counts[id(value)] = 1 + sum(_count(item, counts) for item in items)
    return counts[id(value)]


def load_pickle(data: bytes, source: str) -> Any:
    """Returns the numbers, strings and NumPy arrays of a pickle, in lists, tuples and dicts.

    Raises:
        DatasetError: It is damaged or holds anything else. Nothing of it has run.
    """
    try:
        content = _Unpickler(data).load()
        if _count(content, {}) > _MAX_ITEMS:
            raise pickle.UnpicklingError("its containers hold each other too often")
    except Exception as error:
        raise DatasetError(
            f"'{source}' was not read ({type(error).__name__}: {error}): it is damaged, or more than numbers,"
            " strings, containers and NumPy arrays. Nothing of it was run. Download it again, or convert it "
            "to RoboVerse's JSON form where you trust it."
        ) from error
    return content
