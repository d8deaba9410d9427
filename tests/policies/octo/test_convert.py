"""What the converter does without JAX: names, sizes, and what it refuses."""

import json

import numpy as np

from policies.octo import convert
from policies.octo.sizes import sizes_of
from tests.policies.octo import tiny


def nested():
    tree: dict = {}
    for path, value in tiny.flax_tensors().items():
        *parents, leaf = path.split("/")
        place = tree
        for parent in parents:
            place = place.setdefault(parent, {})
        place[leaf] = value
    return tree


def test_a_tree_becomes_paths():
    found = dict(convert.flattened(nested()))
    assert found.keys() == tiny.flax_tensors().keys()
    assert all(value.dtype == np.float32 for value in found.values())


def test_sizes_follow_from_parameters():
    published = {"model": tiny.config()["model"], "window_size": 2, "optimizer": {}}
    found = convert.converted_config(published, tiny.flax_tensors()) | {"text_config": tiny.numbers.TEXT}
    assert "optimizer" not in found
    assert sizes_of(found) == sizes_of(tiny.config())


def test_a_folder_is_converted_whole(tmp_path, monkeypatch):
    source, words = tmp_path / "published", tmp_path / "t5"
    source.mkdir()
    words.mkdir()
    (source / "config.json").write_text(json.dumps({"model": tiny.config()["model"]}))
    (words / "tokenizer.json").write_text("{}")
    monkeypatch.setattr(convert, "read_parameters", lambda folder, step: nested())
    assert convert.main([str(source), str(tmp_path / "out"), "--tokenizer", str(words)]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "config.json", "flax.safetensors", "tokenizer.json"
    }  # fmt: skip
    assert not list(tmp_path.glob("*.partial"))


def test_what_is_there_is_not_replaced(tmp_path, capsys):
    assert convert.main([str(tmp_path), str(tmp_path)]) == 2
    assert "is there already" in capsys.readouterr().err


def test_a_folder_without_a_checkpoint_is_one_sentence(tmp_path, capsys):
    (tmp_path / "config.json").write_text("{}")
    assert convert.main([str(tmp_path), str(tmp_path / "out"), "--tokenizer", str(tmp_path)]) == 2
    assert "has no checkpoint: no folder named by a step" in capsys.readouterr().err
