"""Protocols of other benchmarks beside tasks that are none of theirs."""

from pathlib import Path

import pytest

from envs.core.errors import ConfigError
from envs.tasks.protocols import PROTOCOLS, check_protocol
from envs.tasks.suites import suite_tasks
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.commands.tested_checkpoint import checkpoint_to_test
from roboverse_learn.config.compose import compose

LIBERO, CALVIN = "libero/object/pick_up_the_milk_and_place_it_in_the_basket", "calvin/D/open_drawer"


@pytest.mark.parametrize(
    ("protocol", "task", "lacks"),
    [
        ("libero", "PickCube", "observation_space, starts"),
        ("libero", CALVIN, "starts"),
        ("calvin", LIBERO, "looks"),
    ],
)
def test_a_protocol_is_refused_for_a_task_of_another_benchmark(protocol: str, task: str, lacks: str):
    with pytest.raises(ConfigError, match=f"protocol={protocol} is not for {task}, which .* {lacks}. Give a"):
        compose("evaluate", ["policy=expert", f"task={task}", f"protocol={protocol}"])


def test_a_protocol_is_refused_for_the_task_that_a_checkpoint_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with RunFolder.open(compose("train", ["policy=act", "preset=quick"]), ["roboverse", "train"]) as opened:
        folder = opened.folder / "checkpoints" / "000100" / "pretrained_model"
        folder.mkdir(parents=True)
        (folder / "config.json").write_text('{"type": "act"}')
        (folder / "model.safetensors").touch()
    config = compose("evaluate", [f"checkpoint={folder}", "protocol=libero"])
    with pytest.raises(
        ConfigError, match="protocol=libero is not for PickCube, which lacks its action_space"
    ):
        checkpoint_to_test(config)


@pytest.mark.parametrize(
    ("protocol", "suite"),
    [
        *(("libero", suite) for suite in ("libero_10", "libero_goal", "libero_pro/goal_swap")),
        ("libero_lerobot", "libero_spatial"),
        ("calvin", "calvin"),
    ],
)
def test_a_protocol_fits_the_tasks_of_its_benchmark(protocol: str, suite: str):
    assert PROTOCOLS.get(protocol)
    for task in suite_tasks(suite):
        check_protocol(protocol, task)
    check_protocol("", "PickCube")
