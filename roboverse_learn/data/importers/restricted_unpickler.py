"""Reads a pickle of numbers, words, lists, dicts, tuples and numpy arrays, and runs nothing of it.

A pickle is a program: whoever unpickles a stranger's file runs the stranger's code. This module does not
unpickle. It walks the opcodes as :mod:`pickletools` lists them and builds containers and arrays itself;
of the callables that a pickle can name, it knows the few by which numpy writes an array, and even those
it does not call. Any other name is refused before anything is built from it.
"""

import pickletools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from envs.core.errors import DatasetError


class _Name(NamedTuple):
    """A callable or class that the pickle names; never looked up."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


_CORES = ("numpy.core.", "numpy._core.")
_RECONSTRUCT = frozenset(_Name(f"{core}multiarray", "_reconstruct") for core in _CORES)
_FROM_BUFFER = frozenset(_Name(f"{core}numeric", "_frombuffer") for core in _CORES)
_SCALAR = frozenset(_Name(f"{core}multiarray", "scalar") for core in _CORES)
_NDARRAY, _DTYPE = _Name("numpy", "ndarray"), _Name("numpy", "dtype")
_ENCODE = _Name("_codecs", "encode")
"""How protocols 0 to 2 write bytes: as text to be encoded."""

_BYTES = _Name("__builtin__", "bytes")
"""How protocols 0 to 2 write no bytes at all: called without arguments."""

_ALLOWED = _RECONSTRUCT | _FROM_BUFFER | _SCALAR | {_NDARRAY, _DTYPE, _ENCODE, _BYTES}
_DTYPE_KINDS = "biufcSU"
"""Booleans, numbers, bytes and text: what holds no Python object."""

_MARK = object()


class _Pending:
    """An array or dtype that a later opcode fills in; the stack and the memo share it."""

    def __init__(self, kind: str, value: Any = None) -> None:
        self.kind, self.value = kind, value


class _Arguments(tuple):
    """A tuple with a name or an unfinished object in it: good for a call, refused as data."""


class RefusedPickleError(DatasetError):
    """A pickle that does more than hold data."""


def load_pickle(data: bytes, source: str) -> Any:
    """Builds what a pickle holds.

    Args:
        data: The pickle.
        source: What to call it in an error message, such as the file's path.

    Returns:
        None, booleans, numbers, text, bytes, numpy arrays and numpy scalars, in lists, tuples and dicts.

    Raises:
        RefusedPickleError: It names a class or function, or uses an opcode, that is more than data.
        DatasetError: It is truncated or no pickle.
    """
    machine = _Machine(source)
    try:
        for opcode, argument, _ in pickletools.genops(data):
            if opcode.name == "STOP":
                break
            machine.run(opcode.name, argument)
        return machine.result()
    except RefusedPickleError:
        raise
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError, MemoryError) as error:
        raise DatasetError(
            f"'{source}' is damaged: not a whole pickle ({type(error).__name__}: {error}). Download it again."
        ) from error


class _Machine:
    """The stack, the memo, and one method per group of opcodes."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._stack: list[Any] = []
        self._memo: dict[int, Any] = {}

    def run(self, opcode: str, argument: Any) -> None:
        """Executes one opcode."""
        if opcode in _LITERALS:
            self._stack.append(argument)
        elif opcode in _CONSTANTS:
            self._stack.append(_CONSTANTS[opcode]())
        else:
            action = _ACTIONS.get(opcode)
            if action is None:
                raise self._refusal(f"uses the opcode {opcode}")
            action(self, argument)

    def result(self) -> Any:
        """Returns what the pickle was of."""
        return self._data(self._stack.pop())

    def _refusal(self, what: str) -> RefusedPickleError:
        return RefusedPickleError(
            f"'{self._source}' was not read: the pickle {what}, which is more than numbers, words, "
            "containers and numpy arrays. Nothing of it was run. Take the file from a source that you trust, "
            "or convert it to RoboVerse's JSON form there."
        )

    def _data(self, value: Any) -> Any:
        """Returns a value that may be an element of a container."""
        if _is_array(value):
            return value.value
        if isinstance(value, _Pending | _Name | _Arguments) or value is _MARK:
            held = f"'{value}'" if isinstance(value, _Name) else "an unfinished object"
            raise self._refusal(f"holds {held}")
        return value

    def _key(self, value: Any) -> Any:
        """Returns a value that may be a key; a tuple of tuples could take forever to hash."""
        if value is not None and not isinstance(value, str | bytes | int | float):
            raise self._refusal(f"has a key of the type {type(value).__name__}")
        return value

    def _pairs(self) -> dict[Any, Any]:
        items = [self._data(item) for item in self._since_mark()]
        return dict(zip(map(self._key, items[::2]), items[1::2], strict=True))

    def _since_mark(self) -> list[Any]:
        """Pops everything above the last mark, and the mark."""
        for position in range(len(self._stack) - 1, -1, -1):
            if self._stack[position] is _MARK:
                items = self._stack[position + 1 :]
                del self._stack[position:]
                return items
        raise ValueError("no mark")

    def _pop(self, _: Any) -> None:
        self._stack.pop()

    def _pop_mark(self, _: Any) -> None:
        self._since_mark()

    def _duplicate(self, _: Any) -> None:
        self._stack.append(self._stack[-1])

    def _memoize(self, _: Any) -> None:
        self._memo[len(self._memo)] = self._stack[-1]

    def _put(self, number: Any) -> None:
        self._memo[int(number)] = self._stack[-1]

    def _get(self, number: Any) -> None:
        self._stack.append(self._memo[int(number)])

    def _append(self, _: Any) -> None:
        value = self._data(self._stack.pop())
        self._container(list).append(value)

    def _appends(self, _: Any) -> None:
        items = [self._data(item) for item in self._since_mark()]
        self._container(list).extend(items)

    def _setitem(self, _: Any) -> None:
        value, key = self._data(self._stack.pop()), self._key(self._stack.pop())
        self._container(dict)[key] = value

    def _setitems(self, _: Any) -> None:
        pairs = self._pairs()
        self._container(dict).update(pairs)

    def _container(self, kind: type) -> Any:
        if type(self._stack[-1]) is not kind:
            raise ValueError(f"a {kind.__name__} was expected")
        return self._stack[-1]

    def _tuple(self, _: Any) -> None:
        self._push_tuple(self._since_mark())

    def _short_tuple(self, size: int) -> None:
        if len(self._stack) < size:
            raise IndexError("the stack is empty")
        items = self._stack[-size:]
        del self._stack[-size:]
        self._push_tuple(items)

    def _push_tuple(self, items: list[Any]) -> None:
        done = [item.value if _is_array(item) else item for item in items]
        names = any(isinstance(item, _Pending | _Name | _Arguments) for item in done)
        self._stack.append(_Arguments(done) if names else tuple(done))

    def _list(self, _: Any) -> None:
        self._stack.append([self._data(item) for item in self._since_mark()])

    def _dict(self, _: Any) -> None:
        self._stack.append(self._pairs())

    def _global(self, argument: str) -> None:
        module, _, name = argument.partition(" ")
        self._name(module, name)

    def _stack_global(self, _: Any) -> None:
        name, module = self._stack.pop(), self._stack.pop()
        self._name(str(module), str(name))

    def _name(self, module: str, name: str) -> None:
        named = _Name(module, name)
        if named not in _ALLOWED:
            raise self._refusal(f"names '{named}'")
        self._stack.append(named)

    def _reduce(self, _: Any) -> None:
        """Builds what numpy's own callables would have made of these arguments."""
        arguments, function = self._stack.pop(), self._stack.pop()
        if not isinstance(function, _Name) or not isinstance(arguments, tuple):
            raise self._refusal("calls what is no name")
        if function in _RECONSTRUCT and arguments[0] == _NDARRAY:
            self._stack.append(_Pending("array"))
        elif function == _DTYPE:
            self._stack.append(_Pending("dtype", self._dtype(str(arguments[0]))))
        elif function in _SCALAR:
            dtype = self._dtype_of(arguments[0])
            self._stack.append(np.frombuffer(arguments[1], dtype, count=1)[0])
        elif function in _FROM_BUFFER:
            buffer, dtype, shape, order = arguments
            self._stack.append(_array(buffer, self._dtype_of(dtype), shape, order == "F"))
        elif function == _BYTES and not arguments:
            self._stack.append(b"")
        elif function == _ENCODE and arguments[1:] in (("latin1",), ("latin-1",)):
            self._stack.append(str(arguments[0]).encode("latin-1"))
        else:
            raise self._refusal(f"calls '{function}' with other arguments than numpy does")

    def _build(self, _: Any) -> None:
        """Fills in an array or dtype; nothing else has a state that could be set."""
        state, target = self._stack.pop(), self._stack[-1]
        if not isinstance(target, _Pending) or not isinstance(state, tuple):
            raise self._refusal("sets the state of an object")
        if target.kind == "dtype":
            target.value = target.value.newbyteorder(str(state[1]) if state[1] != "|" else "=")
        else:
            _, shape, dtype, fortran, data = state
            target.value = _array(data, self._dtype_of(dtype), shape, bool(fortran))

    def _dtype(self, code: str) -> np.dtype:
        dtype = np.dtype(code)
        if dtype.kind not in _DTYPE_KINDS or dtype.fields or dtype.subdtype:
            raise self._refusal(f"has an array of '{code}'")
        return dtype

    def _dtype_of(self, value: Any) -> np.dtype:
        if not isinstance(value, _Pending) or value.kind != "dtype":
            raise self._refusal("describes an array by something that is no dtype")
        return value.value

    @staticmethod
    def nothing(machine: "_Machine", argument: Any) -> None:
        """Is what framing opcodes do."""


def _is_array(value: Any) -> bool:
    return isinstance(value, _Pending) and value.kind == "array" and value.value is not None


def _array(data: Any, dtype: np.dtype, shape: Any, fortran: bool) -> np.ndarray:
    """Returns an array of its own memory; data that do not fill the shape are an error."""
    if not isinstance(data, bytes | bytearray):
        raise ValueError("an array's data are no bytes")
    shape = tuple(int(size) for size in shape)
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C").copy()


_LITERALS = frozenset(
    {
        *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
        *("STRING", "BINSTRING", "SHORT_BINSTRING"),
        *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"),
        *("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    }
)
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
    "EMPTY_TUPLE": tuple,
    "MARK": lambda: _MARK,
}
_ACTIONS: dict[str, Callable[[_Machine, Any], None]] = {
    "PROTO": _Machine.nothing,
    "FRAME": _Machine.nothing,
    "POP": _Machine._pop,
    "POP_MARK": _Machine._pop_mark,
    "DUP": _Machine._duplicate,
    "MEMOIZE": _Machine._memoize,
    "PUT": _Machine._put,
    "BINPUT": _Machine._put,
    "LONG_BINPUT": _Machine._put,
    "GET": _Machine._get,
    "BINGET": _Machine._get,
    "LONG_BINGET": _Machine._get,
    "APPEND": _Machine._append,
    "APPENDS": _Machine._appends,
    "SETITEM": _Machine._setitem,
    "SETITEMS": _Machine._setitems,
    "LIST": _Machine._list,
    "DICT": _Machine._dict,
    "TUPLE": _Machine._tuple,
    "TUPLE1": lambda machine, _: machine._short_tuple(1),
    "TUPLE2": lambda machine, _: machine._short_tuple(2),
    "TUPLE3": lambda machine, _: machine._short_tuple(3),
    "GLOBAL": _Machine._global,
    "STACK_GLOBAL": _Machine._stack_global,
    "REDUCE": _Machine._reduce,
    "BUILD": _Machine._build,
}
