import collections
import os
import pickle
import struct
import subprocess

import numpy as np
import pytest

from envs.core.errors import DatasetError
from roboverse_learn.data.importers.restricted_unpickler import load_pickle

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_data_round_trip(protocol):
    shared = [1.5, "é", b"\x00\xff", b"", None, True, False, -5, 2**70, 300, 70000]
    data = {"shared": shared, "again": [shared, (shared,), (), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)], 7: {}}
    read = load_pickle(pickle.dumps(data, protocol), "file")
    assert read == data
    assert read["shared"] is read["again"][0]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_arrays_round_trip_into_memory_of_their_own(protocol):
    arrays = [
        np.arange(12.0).reshape(3, 4),
        np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)),
        np.arange(3, dtype=">i4"),
        np.zeros((0, 3)),
        np.array(True),
        np.array(["left", "right"]),
        np.float32(0.5),
        np.bool_(True),
    ]
    for values in arrays:
        read = load_pickle(pickle.dumps([values, (values, values)], protocol), "file")
        for one in (read[0], *read[1]):
            np.testing.assert_array_equal(one, values)
            assert one.dtype.newbyteorder("=") == values.dtype.newbyteorder("=")
            assert np.shape(one) == values.shape
            assert not isinstance(one, np.ndarray) or one.flags.writeable


class Reduced:
    """Pickles as a call of ``call``."""

    def __init__(self, call, arguments):
        self.call, self.arguments = call, arguments

    def __reduce__(self):
        return self.call, self.arguments


class Plain:
    def __setstate__(self, state):
        raise AssertionError("was run")


def malicious(path):
    """Pickles that would make the file ``path``, or build objects, with an ordinary unpickler."""
    touch = f"open({str(path)!r}, 'w')"
    plain = Plain()
    plain.hidden = touch
    return {
        "system": Reduced(os.system, (f"touch {path}",)),
        "eval": Reduced(eval, (touch,)),
        "exec": Reduced(exec, (touch,)),
        "popen": Reduced(subprocess.Popen, (["touch", str(path)],)),
        "getattr": Reduced(getattr, ("x", "upper")),
        "nested": [{"pos": [0.0, Reduced(os.system, (f"touch {path}",))]}],
        "chain": Reduced(getattr, (Reduced(__import__, ("os",)), "system")),
        "state": plain,
        "ordered": collections.OrderedDict(a=1),
        "objects": np.array([Reduced(os.system, (f"touch {path}",))], dtype=object),
        "records": np.zeros(2, dtype=[("pos", float)]),
        "class": Plain,
        "set": {1, 2},
        "memmap": Reduced(np.memmap, (str(path), "uint8", "w+", 0, (1,))),
        "load": Reduced(np.load, (str(path), None, True)),
    }


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("kind", sorted(malicious("x")))
def test_malicious_pickle_is_refused_and_nothing_runs(tmp_path, protocol, kind):
    made = tmp_path / "made"
    data = pickle.dumps(malicious(made)[kind], protocol)
    with pytest.raises(DatasetError, match=r"^'file' was not read .* Nothing of it was run"):
        load_pickle(data, "file")
    assert not made.exists()


def short(text):
    return pickle.SHORT_BINUNICODE + struct.pack("<B", len(text)) + text.encode()


RECONSTRUCT = short("numpy._core.multiarray") + short("_reconstruct") + pickle.STACK_GLOBAL


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"cos\nsystem\n(S'true'\ntR.", "names 'os.system'"),
        (b"(S'true'\nios\nsystem\n.", "KeyError: 105"),
        (b"(cbuiltins\neval\nS'1'\no.", "names 'builtins.eval'"),
        (b"\x80\x02cnumpy\nndarray\n)\x81.", "KeyError: 129"),
        (b"Pname\n.", "KeyError: 80"),
        (b"\x82\x01.", "KeyError: 130"),
        (b"\x97.", "KeyError: 151"),
        (b"]}b.", "sets the state of a list"),
        (b"c_codecs\nencode\n}S'__defaults__'\n(tsb.", "sets the state of a function"),
        (b"cnumpy\ndtype\n.", "holds a type"),
        (b"cnumpy\nndarray\n(K\x01tR.", "not callable"),
        (b"cnumpy\ndtype\n(S'O8'\ntR.", "has an array of 'O8'"),
        (RECONSTRUCT + b")R(K\x01K\x01\x85N\x89C\x08" + b"\xff" * 8 + b"tb.", "no attribute 'value'"),
        (b"K\x01K\x02R.", "TypeError"),
        (b"cos\nsys.modules\n.", "names 'os.sys.modules'"),
        (short("numpy") + short("core.multiarray.os.system") + b"\x93.", "names 'numpy.core.multiarray.os."),
    ],
)
def test_opcodes_that_do_more_than_hold_data_are_refused(data, says):
    with pytest.raises(DatasetError, match=says):
        load_pickle(data, "file")


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_truncated_pickle_is_refused(protocol):
    data = pickle.dumps({"pos": [0.5, np.arange(4.0)], "name": "box"}, protocol)
    for length in range(len(data)):
        with pytest.raises(DatasetError, match="'file'"):
            load_pickle(data[:length], "file")


def test_random_and_damaged_bytes_give_data_or_one_error():
    rng = np.random.default_rng(0)
    good = {"pos": [0.5, np.arange(4.0)], "name": "box", "n": [1, 2, (3, 4)]}
    files = [rng.bytes(int(size)) for size in rng.integers(1, 200, size=1000)]
    for protocol in PROTOCOLS:
        whole = pickle.dumps(good, protocol)
        for _ in range(500):
            damaged = bytearray(whole)
            for at in rng.integers(len(whole), size=2):
                damaged[at] = rng.integers(256)
            files.append(bytes(damaged))
    for file in files:
        try:
            load_pickle(file, "file")
        except DatasetError as error:
            assert "'file'" in str(error)


def tuples(times):
    """A tuple that holds the same tuple twice, and so on: 2**times leaves in a few bytes."""
    return b"K\x01" + b"2\x86" * times


HUGE = struct.pack("<Q", 1 << 45)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"}" + tuples(40) + b"K\x01s.", "a tuple as a key"),
        (tuples(40) + b".", "hold each other too often"),
        (b"]q\x00h\x00a.", "hold each other too often"),
        (b"]" * 100_000 + b"a" * 99_999 + b".", "RecursionError"),
        (b"K\x01r\xff\xff\xff\xff]" + b"j\xff\xff\xff\x7fa.", "Memo value not found"),
        (pickle.BYTEARRAY8 + HUGE + b"ab.", "EOFError"),
        (pickle.BINBYTES8 + HUGE + b"ab.", "EOFError"),
        (pickle.FRAME + HUGE + b"N", "EOFError"),
        (pickle.dumps(np.arange(3.0), 4).replace(b"K\x03\x85", b"J\xff\xff\xff\x7f\x85"), "cannot reshape"),
    ],
    ids=["hash", "nested", "cycle", "deep", "memo", "bytearray", "bytes", "frame", "shape"],
)
def test_bombs_are_refused(data, says):
    with pytest.raises(DatasetError, match=says):
        load_pickle(data, "file")


def test_arrays_of_shared_bytes_are_bounded_by_the_file():
    buffer = b"C\x08" + b"\x00" * 8 + b"\x94"
    dtype = b"cnumpy\ndtype\n(S'f8'\ntR\x94"
    frombuffer = b"cnumpy._core.numeric\n_frombuffer\n\x94"
    call = b"h\x02(h\x00h\x01K\x01S'C'\ntR"
    assert load_pickle(buffer + dtype + frombuffer + b"](" + call + b"e.", "file") == [0.0]
    with pytest.raises(DatasetError, match="arrays are larger than the file"):
        load_pickle(
            buffer.replace(b"C\x08" + b"\x00" * 8, b"B\x00\x10\x00\x00" + b"\x00" * 4096)
            + dtype
            + frombuffer
            + b"]("
            + call.replace(b"K\x01", b"M\x00\x02") * 2
            + b"e.",
            "file",
        )
