"""Hashes of values and files."""

import pytest

from envs.core.fingerprint import canonical_json, digest, file_hash, fingerprint


def test_canonical_json_has_one_form():
    assert canonical_json({"b": 1, "a": [1.5, None]}) == '{"a":[1.5,null],"b":1}'
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical_json({"a": float("nan")})


def test_a_name_is_the_beginning_of_the_hash_of_the_one_text():
    assert fingerprint({}).startswith("44136fa355b3678a1146ad16f7e8649e")  # sha256 of the two letters {}
    assert digest({}) == "44136fa3"
    assert digest({"b": 1, "a": 2}) == digest({"a": 2, "b": 1}) != digest({"a": 1, "b": 2})


def test_file_hash(tmp_path):
    (tmp_path / "f").write_bytes(b"abc")
    assert file_hash(tmp_path / "f").startswith("ba7816bf8f01cfea")
