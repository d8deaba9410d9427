import collections
import os
import pickle
import pickletools
import struct
import subprocess

import numpy as np
import pytest

from envs.core.errors import DatasetError
from roboverse_learn.data.importers.restricted_unpickler import RefusedPickleError, load_pickle

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_data_come_back_as_they_were(protocol):
    shared = [1.5, "é", b"\x00\xff", b"", None, True, False, -5, 2**70, 300, 70000]
    data = {"shared": shared, "again": [shared, (shared,), (), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)], 7: {}}
    read = load_pickle(pickle.dumps(data, protocol), "file")
    assert read == data
    assert read["shared"] is read["again"][0]


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(
    "values",
    [
        np.arange(12.0).reshape(3, 4),
        np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)),
        np.arange(3, dtype=">i4"),
        np.zeros((0, 3)),
        np.array(True),
        np.array(["left", "right"]),
        np.float32(0.5),
        np.bool_(True),
    ],
    ids=lambda values: f"{values.dtype}{values.shape}",
)
def test_arrays_come_back_as_they_were(protocol, values):
    read = load_pickle(pickle.dumps([values, (values, values)], protocol), "file")
    for one in (read[0], *read[1]):
        np.testing.assert_array_equal(one, values)
        assert one.dtype == values.dtype
        assert np.shape(one) == values.shape


def test_an_array_has_memory_of_its_own():
    read = load_pickle(pickle.dumps(np.arange(3.0), 5), "file")
    read[0] = 7.0
    assert read.tolist() == [7.0, 1.0, 2.0]


class Reduced:
    """Pickles as the call that it is given."""

    def __init__(self, call, arguments, state=None):
        self.call, self.arguments, self.state = call, arguments, state

    def __reduce__(self):
        return (self.call, self.arguments) if self.state is None else (self.call, self.arguments, self.state)


class Plain:
    def __setstate__(self, state):
        raise AssertionError("was run")


def malicious(path):
    """Pickles that would make the file ``path``, or build objects, with any ordinary unpickler."""
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
def test_a_malicious_pickle_is_refused_and_nothing_runs(tmp_path, protocol, kind):
    made = tmp_path / "made"
    data = pickle.dumps(malicious(made)[kind], protocol)
    with pytest.raises(
        RefusedPickleError, match=r"^'file' was not read: the pickle .* Nothing of it was run"
    ):
        load_pickle(data, "file")
    assert not made.exists()


def short(text):
    return pickle.SHORT_BINUNICODE + struct.pack("<B", len(text)) + text.encode()


RECONSTRUCT = short("numpy._core.multiarray") + short("_reconstruct") + pickle.STACK_GLOBAL


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"cos\nsystem\n(S'true'\ntR.", "names 'os.system'"),
        (b"(S'true'\nios\nsystem\n.", "uses the opcode INST"),
        (b"(cbuiltins\neval\nS'1'\no.", "names 'builtins.eval'"),
        (b"(c_codecs\nencode\nS'1'\no.", "uses the opcode OBJ"),
        (b"\x80\x02cnumpy\nndarray\n)\x81.", "uses the opcode NEWOBJ"),
        (b"Pname\n.", "uses the opcode PERSID"),
        (b"K\x01Q.", "uses the opcode BINPERSID"),
        (b"\x82\x01.", "uses the opcode EXT1"),
        (b"\x97.", "uses the opcode NEXT_BUFFER"),
        (b"]}b.", "sets the state of an object"),
        (b"cnumpy\nndarray\n.", "holds 'numpy.ndarray'"),
        (b"](cnumpy\nndarray\nK\x01\x86e.", "holds an unfinished object"),
        (b"cnumpy\nndarray\n(K\x01tR.", "calls 'numpy.ndarray' with other arguments than numpy does"),
        (b"c_codecs\nencode\n(S'x'\nS'rot13'\ntR.", "calls '_codecs.encode' with other arguments"),
        (b"cnumpy\ndtype\n(S'O8'\ntR.", "has an array of 'O8'"),
        (RECONSTRUCT + b"cnumpy\nndarray\n(K\x00t\x87R.", None),
        (b"K\x01K\x02R.", "calls what is no name"),
        (b"cos\nsys.modules\n.", "names 'os.sys.modules'"),
        (short("numpy") + short("core.multiarray.os.system") + b"\x93.", "names 'numpy.core.multiarray.os."),
    ],
)
def test_opcodes_that_do_more_than_hold_data_are_refused(data, says):
    kind = DatasetError if says is None else RefusedPickleError
    with pytest.raises(kind, match=says):
        load_pickle(data, "file")


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_no_truncated_pickle_is_read(protocol):
    data = pickle.dumps({"pos": [0.5, np.arange(4.0)], "name": "box"}, protocol)
    for length in range(len(data)):
        with pytest.raises(DatasetError, match="'file'"):
            load_pickle(data[:length], "file")


def test_no_damaged_pickle_is_a_crash():
    data = pickle.dumps({"pos": [0.5, np.arange(4.0)], "name": "box", "n": [1, 2, (3, 4)]}, 4)
    rng = np.random.default_rng(0)
    for _ in range(2000):
        damaged = bytearray(data)
        for at in rng.integers(len(data), size=2):
            damaged[at] = rng.integers(256)
        try:
            load_pickle(bytes(damaged), "file")
        except DatasetError as error:
            assert "'file'" in str(error)


def test_bombs_are_small_or_refused():
    # A tuple of the same tuple twice, forty times over: 2**40 leaves, and its hash would visit them all.
    doubled = b"K\x01" + b"2\x86" * 40
    assert isinstance(load_pickle(doubled + b".", "file"), tuple)
    with pytest.raises(RefusedPickleError, match="has a key of the type tuple"):
        load_pickle(b"}" + doubled + b"K\x01s.", "file")
    deep = b"]" * 100_000 + b"a" * 99_999 + b"."
    assert isinstance(load_pickle(deep, "file"), list)
    huge = pickle.dumps(np.arange(3.0), 4).replace(b"K\x03\x85", b"J\xff\xff\xff\x7f\x85")
    assert any(opcode.name == "BININT" for opcode, _, _ in pickletools.genops(huge))
    with pytest.raises(DatasetError, match="cannot reshape"):
        load_pickle(huge, "file")
