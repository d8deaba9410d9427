"""Run folders: resuming, locks, manifests, seeds."""

import json
import logging
from pathlib import Path

import pytest
import yaml

from envs.core.errors import ConfigError
from roboverse_learn.commands.run_folder import (
    CONFIG_FILE,
    MANIFEST_FILE,
    RunFolder,
    default_folder,
    read_config,
    read_facts,
    seed_of,
)
from roboverse_learn.commands.run_identity import run_name
from roboverse_learn.config.compose import compose
from roboverse_learn.config.schema import TrainRunConfig
from roboverse_learn.config.serialize import default_values, to_values

COMMAND = ["roboverse", "train", "preset=quick"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def config(*words: str) -> TrainRunConfig:
    return compose("train", ["preset=quick", *words])


def test_the_same_command_finds_the_same_run_and_continues_it() -> None:
    with RunFolder.open(config(), COMMAND) as first, first.stage("collect") as facts:
        facts["num_episodes"] = 9
    with RunFolder.open(config("episodes=3"), COMMAND) as second:
        assert second.folder == first.folder
        assert second.stages["collect"]["num_episodes"] == 9
    manifest = json.loads((first.folder / MANIFEST_FILE).read_text())
    assert [start["command"] for start in manifest["starts"]] == ["roboverse train preset=quick"] * 2
    assert manifest["status"] == "done"


def test_resume_false_starts_a_run_beside_it() -> None:
    names = []
    for _ in range(3):
        with RunFolder.open(config("resume=false"), COMMAND) as run:
            names.append(run.name)
    base = run_name(config())
    assert names == [base, f"{base}-2", f"{base}-3"]


@pytest.mark.slow
def test_the_resolved_configuration_is_saved_and_read_back() -> None:
    chosen = config("policy=diffusion", "train.betas=[0.8,0.9]", "levels=[1]", "task_kwargs.variant=lift")
    with RunFolder.open(chosen, COMMAND) as run:
        pass
    assert read_config(run.folder) == chosen
    assert json.loads((run.folder / MANIFEST_FILE).read_text())["config"] == to_values(chosen)
    assert run.folder == Path("runs/PickCube/diffusion") / run_name(chosen)


def test_run_names_a_run_to_continue_with_its_own_configuration() -> None:
    with RunFolder.open(config("policy=diffusion", "seed=5"), COMMAND) as run:
        pass
    again = compose("train", [f"run={run.folder}", "train.steps=123456"])
    assert (again.policy_name, again.seed, again.preset) == ("diffusion", 5, "quick")
    assert again.train.steps == 123456
    assert again.policy == config("policy=diffusion").policy
    with RunFolder.open(again, COMMAND) as continued:
        assert continued.folder == run.folder


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_run_is_not_continued_with_fewer_steps_than_it_has_done() -> None:
    with RunFolder.open(config("train.steps=2000"), COMMAND) as run:
        (run.folder / "checkpoints/001500").mkdir(parents=True)
    before = files_of(run.folder)
    fewer = compose("train", [f"run={run.folder}", "train.steps=1000"])
    with pytest.raises(
        ConfigError, match=r"has done 1,500 steps, and train.steps=1000 is fewer. Give more th"
    ):
        RunFolder.open(fewer, COMMAND)
    assert files_of(run.folder) == before
    for steps in (1500, 1800, 3000):  # those that it has done, fewer than were wanted, and more
        with RunFolder.open(compose("train", [f"run={run.folder}", f"train.steps={steps}"]), COMMAND):
            assert read_config(run.folder).train.steps == steps


def test_the_first_command_of_a_run_that_was_extended_finds_it_as_it_is() -> None:
    with RunFolder.open(config("train.steps=1000"), COMMAND) as run:
        pass
    with RunFolder.open(compose("train", [f"run={run.folder}", "train.steps=3000"]), COMMAND):
        (run.folder / "checkpoints/003000").mkdir(parents=True)
    with RunFolder.open(config("train.steps=1000"), COMMAND) as again:
        assert again.folder == run.folder
    assert read_config(run.folder).train.steps == 3000


@pytest.mark.slow
@pytest.mark.parametrize("word", ["seed=1", "policy.dim_model=256", "policy=diffusion", "num_demos=3"])
def test_a_run_is_not_continued_as_another(word: str) -> None:
    with RunFolder.open(config(), COMMAND) as run:
        pass
    other = compose("train", [f"run={run.folder}", "preset=quick", word])
    with pytest.raises(ConfigError, match=r"was started with another configuration: you gave .*it has"):
        RunFolder.open(other, COMMAND)
    assert read_config(run.folder) == config()


@pytest.mark.parametrize(
    ("key", "value", "usual"),
    [
        ("train.augment.hue", "0.1", "0"),
        ("train.augment.swap_camera", "wrist", "front"),
        ("collect.steps_per_look", "5", "0"),
        ("policy.n_residual_blocks", "1", "0"),
        ("robot", "iiwa", "franka"),
    ],
)
def test_a_run_is_not_continued_with_a_key_back_at_its_usual_value(key: str, value: str, usual: str) -> None:
    with RunFolder.open(compose("train", ["preset=quick", f"{key}={value}"]), COMMAND) as run:
        pass
    back = compose("train", [f"run={run.folder}", "preset=quick", f"{key}={usual}"])
    with pytest.raises(ConfigError, match=rf"you gave {key}=\S*, it has {value}\. Leave"):
        RunFolder.open(back, COMMAND)


def test_a_run_of_another_policy_is_told_by_its_name_alone() -> None:
    with RunFolder.open(config(), COMMAND) as run:
        pass
    with pytest.raises(ConfigError, match=r"you gave policy_name=diffusion, it has act\. Leave"):
        RunFolder.open(compose("train", [f"run={run.folder}", "preset=quick", "policy=diffusion"]), COMMAND)


def test_a_run_does_not_take_the_place_of_anothers_results(tmp_path: Path) -> None:
    words = ["preset=quick", f"results_dir={tmp_path / 'results'}"]
    kept = tmp_path / "results/v2/PickCube/act/mine.json"
    kept.parent.mkdir(parents=True)
    kept.write_text(json.dumps({"config": to_values(compose("train", [*words, "seed=0"]))}))
    with pytest.raises(
        ConfigError, match=r"mine\.json' has the results of another run .* seed=1, it has 0\. Name"
    ):
        RunFolder.open(compose("train", [*words, "seed=1", f"run={tmp_path / 'b/mine'}"]), COMMAND)
    RunFolder.open(compose("train", [*words, "seed=0", f"run={tmp_path / 'c/mine'}"]), COMMAND).close()
    RunFolder.open(compose("train", [*words, "seed=1", f"run={tmp_path / 'b/other'}"]), COMMAND).close()
    begun = to_values(compose("train", [*words, "seed=0", "train.resume_from=/gone/checkpoint"]))
    kept.write_text(json.dumps({"config": begun}))
    with pytest.raises(ConfigError, match=r"train\.resume_from=nothing, it has /gone/checkpoint\. Name"):
        RunFolder.open(compose("train", [*words, "seed=0", f"run={tmp_path / 'd/mine'}"]), COMMAND)


def test_a_run_is_open_in_one_process_only() -> None:
    with (
        RunFolder.open(config(), COMMAND),
        pytest.raises(ConfigError, match=r"Another process is working on the run .*resume=false"),
    ):
        RunFolder.open(config(), COMMAND)
    RunFolder.open(config(), COMMAND).close()


def test_a_stage_that_fails_is_recorded_and_tried_again() -> None:
    with (
        pytest.raises(ValueError, match="diverged"),
        RunFolder.open(config(), COMMAND) as run,
        run.stage("train"),
    ):
        raise ValueError("diverged")
    facts = read_facts(run.folder, "train")
    assert facts["status"] == "stopped" and facts["error"] == "ValueError: diverged"
    assert json.loads((run.folder / MANIFEST_FILE).read_text())["status"] == "stopped"
    with RunFolder.open(config(), COMMAND) as run, run.stage("train") as facts:
        facts["steps"] = 4
    facts = read_facts(run.folder, "train")
    assert (facts["status"], facts["steps"], "error" in facts) == ("done", 4, False)
    assert facts["seconds"] >= 0


def test_the_manifest_says_where_the_code_came_from() -> None:
    with RunFolder.open(config(), COMMAND) as run:
        pass
    (start,) = json.loads((run.folder / MANIFEST_FILE).read_text())["starts"]
    assert {"python", "torch", "lerobot", "mujoco"} <= set(start["versions"])
    assert start["git"] is None or set(start["git"]) == {"sha", "dirty"}


def test_log_of_a_run_is_in_its_folder() -> None:
    with RunFolder.open(config(), COMMAND) as run:
        logging.getLogger("roboverse_learn.test").warning("a line to find again")
    logging.getLogger("roboverse_learn.test").warning("not of this run")
    text = (run.folder / "run.log").read_text()
    assert "a line to find again" in text and "not of this run" not in text


def test_a_broken_manifest_does_not_stop_a_run() -> None:
    with RunFolder.open(config(), COMMAND) as run:
        pass
    (run.folder / MANIFEST_FILE).write_text('{"starts": [')
    assert read_facts(run.folder, "train") == {}
    with RunFolder.open(config(), COMMAND) as run:
        assert run.stages == {}


@pytest.mark.parametrize("content", ["", "train: [", "- 1\n- 2", "\x00"])
def test_a_broken_configuration_is_a_clear_error(content: str) -> None:
    with RunFolder.open(config(), COMMAND) as run:
        pass
    (run.folder / CONFIG_FILE).write_text(content)
    with pytest.raises(ConfigError, match=CONFIG_FILE):
        read_config(run.folder)


def test_a_configuration_that_was_cut_names_its_file_beside_the_value() -> None:
    with RunFolder.open(config(), COMMAND) as run:
        pass
    path = run.folder / CONFIG_FILE
    whole = path.read_text()
    path.write_text(whole.replace("n_heads: ", "n_heads: 1"))
    with pytest.raises(ConfigError, match=rf"'{path}' does not fit .*n_heads=1\d+.* Restore it from a copy"):
        read_config(run.folder)
    path.write_text("{}")
    with pytest.raises(ConfigError, match=rf"'{path}' is not the configuration of a run"):
        read_config(run.folder)


def test_a_folder_that_is_no_run_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"is not the folder of a run: it has no config\.yaml"):
        read_config(tmp_path)


def test_streams_of_randomness_are_independent_and_repeatable() -> None:
    seeds = {
        (seed, stream): seed_of(config(f"seed={seed}"), stream)
        for seed in (0, 1)
        for stream in ("training", "collection")
    }
    assert len(set(seeds.values())) == 4
    assert seed_of(config("seed=1"), "training") == seeds[1, "training"]


def test_the_saved_configuration_is_yaml_that_a_person_can_read() -> None:
    with RunFolder.open(config(), COMMAND) as run:
        pass
    values = yaml.safe_load((run.folder / CONFIG_FILE).read_text())
    assert list(values) == list(default_values("train"))
    assert default_folder(config()) == run.folder


def test_a_folder_of_other_files_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "demos/meta").mkdir(parents=True)
    with pytest.raises(
        ConfigError, match=r"'demos' is no run and holds other files, such as 'meta'\. Name an"
    ):
        RunFolder.open(config("run=demos"), COMMAND)
    assert [path.name for path in (tmp_path / "demos").iterdir()] == ["meta"]


def test_a_run_that_ended_before_it_was_described_is_continued(tmp_path: Path) -> None:
    (tmp_path / "early").mkdir()
    (tmp_path / "early/.lock").touch()
    with RunFolder.open(config("run=early"), COMMAND) as run:
        assert (run.folder / CONFIG_FILE).is_file()
