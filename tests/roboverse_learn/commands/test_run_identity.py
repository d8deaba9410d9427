"""Names of runs: what decides what is learned changes them, and nothing else does."""

from pathlib import Path

import pytest

from roboverse_learn.commands.run_identity import run_name
from roboverse_learn.config.compose import compose
from roboverse_learn.config.schema import TrainRunConfig


def config(*words: str) -> TrainRunConfig:
    return compose("train", ["preset=quick", *words])


@pytest.mark.parametrize(
    "word",
    [
        "seed=1",
        "level=2",
        "only=camera",
        "num_demos=50",
        "lr=0.5",
        "policy.chunk_size=80",
        "simulator_settings.impratio=5",
        "scenario.physics.decimation=50",
        "scenario.lighting.array_shape=[3,4]",
        "renderer=gl",
        "materials=m",
    ],
)
def test_what_decides_the_outcome_changes_the_name(word: str) -> None:
    assert run_name(config(word)) != run_name(config())


@pytest.mark.parametrize(
    "word",
    [
        "device=cpu",
        "collect.num_workers=2",
        "evaluate.num_envs=3",
        "episodes=5",
        "slow_ok=true",
        "log_every=7",
        "train.cuda_graphs=true",
    ],
)
def test_what_decides_nothing_keeps_the_name(word: str) -> None:
    assert run_name(config(word)) == run_name(config())


def test_a_name_can_be_read() -> None:
    assert run_name(config("seed=3")).startswith("quick-level0-seed3-")
    assert run_name(config("only=lighting")).startswith("quick-lighting-alone-seed0-")


def test_a_run_keeps_its_name_where_younger_augmentation_is_off():
    recorded = Path(__file__).parents[3] / "results/v2/PickCube/act"
    assert (recorded / f"{run_name(compose('train', ['recipe=act_v1', 'task=PickCube']))}.json").is_file()
    quick = ["policy=act", "task=PickCube", "preset=quick"]
    names = {run_name(compose("train", [*quick, *words])) for words in ([], ["train.augment.hue=0.1"])}
    assert len(names) == 2


def test_a_checkpoint_to_begin_with_is_named_by_its_weights_and_not_by_its_path(tmp_path: Path) -> None:
    for name, weights in (("a", b"1"), ("copy", b"1"), ("b", b"2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text("{}")
        (tmp_path / name / "model.safetensors").write_bytes(weights)
    names = {name: run_name(config(f"train.resume_from={tmp_path / name}")) for name in ("a", "copy", "b")}
    assert names["a"] == names["copy"] != names["b"]
    assert run_name(config()) not in names.values()
    assert run_name(config("train.resume_from=")) == run_name(config())
