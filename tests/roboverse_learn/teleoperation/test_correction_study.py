"""The study of corrections, as small as it gets: one round, and nothing twice."""

import logging

import pytest

from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.teleoperation.correction_study import main
from roboverse_learn.teleoperation.recording import open_recordings

pytestmark = pytest.mark.long


def words(folder):
    return [
        *("task=PickCube", "level=0", "start=2", "per_round=1", "rounds=1", f"out={folder / 'study'}"),
        *("image_size=32", "cameras=[front]", "device=cpu", "slow_ok=true", "collect.num_workers=1"),
        *("train.steps=2", "train.batch_size=2", "train.num_threads=1", "policy.dim_model=32"),
        *("policy.n_heads=2", "evaluate.episodes=1", "evaluate.videos=0", f"runs_dir={folder / 'runs'}"),
        f"results_dir={folder / 'results'}",
    ]


def test_a_round_of_corrections_is_compared_with_as_many_plain_demonstrations(tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        assert main(words(tmp_path)) == 0
    lines = [record.message for record in caplog.records if "with corrections" in record.message]
    assert [line.split()[0] for line in lines] == ["2", "3"]
    rounds = tmp_path / "study/round1"
    merged, plain = (DatasetInfo.open(rounds / name) for name in ("corrections", "plain"))
    assert merged.num_episodes == plain.num_episodes == 3
    alone = DatasetInfo.open(rounds / "corrections-alone")
    assert alone.num_episodes == 1 and alone.read_columns()["intervention"].all()
    (facts,) = open_recordings(tmp_path / "study/recordings").values()
    assert facts["policy"] and facts["mark"] == "success"
    weights = {path: path.read_bytes() for path in (tmp_path / "runs").rglob("model.safetensors")}
    assert len(list((tmp_path / "runs/PickCube/act").iterdir())) == 3
    assert main(words(tmp_path)) == 0, "what is done is done"
    assert {path: path.read_bytes() for path in (tmp_path / "runs").rglob("model.safetensors")} == weights


def test_wrong_words_end_before_the_first_collection(tmp_path, caplog):
    assert main([*words(tmp_path), "train.stepz=2"]) == 2
    assert "train.stepz" in caplog.text and not (tmp_path / "study").exists()
