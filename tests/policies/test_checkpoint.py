"""Broken checkpoints: what was given, what is wrong, what to do."""

import json

import numpy as np
import pytest
import torch

import policies
from envs.core.atomic import atomic_directory
from envs.core.errors import PolicyError, UnknownNameError
from policies.checkpoint import check_learned, resolve
from tests.policies.examples import FEATURES, IMAGE, make, observation, stats

ADVICE = "Name another checkpoint, or train again."


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "checkpoint"
    make("act").save(folder)
    return folder


@pytest.fixture
def broken(saved, tmp_path):
    """A copy that a test may damage."""
    import shutil

    return shutil.copytree(saved, tmp_path / "checkpoint")


def message(folder) -> str:
    with pytest.raises(PolicyError) as caught:
        policies.load(folder)
    assert ADVICE in str(caught.value)
    return str(caught.value)


def test_a_folder_that_is_not_there(tmp_path):
    assert f"Checkpoint '{tmp_path / 'nothing'}' does not exist" in message(tmp_path / "nothing")


def test_a_run_without_its_link_has_its_newest_checkpoint(tmp_path):
    for step in ("950000", "1000000", "1000000.old"):
        folder = tmp_path / "checkpoints" / step / "pretrained_model"
        folder.mkdir(parents=True)
        (folder / "config.json").write_text("{}")
    assert resolve(tmp_path) == tmp_path / "checkpoints/1000000/pretrained_model"
    (tmp_path / "checkpoints/last").symlink_to("950000")
    assert resolve(tmp_path) == tmp_path / "checkpoints/last/pretrained_model"
    assert resolve(tmp_path / "checkpoints") == resolve(tmp_path), "the folder of a run's checkpoints"


def checkpoint_of(run):
    folder = run / "checkpoints/000100/pretrained_model"
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    (run / "config.yaml").write_text("")


@pytest.mark.parametrize("task", ["PickCube", "libero/spatial/pick_up_the_bowl"])
def test_a_folder_that_holds_runs_names_some_of_them(task, tmp_path):
    folder = tmp_path / "runs" / task / "act"
    for index in range(7):
        checkpoint_of(folder / f"run{index}")
    (folder / "begun").mkdir()
    (folder / "begun/config.yaml").write_text("")
    (tmp_path / "runs/data/meta").mkdir(parents=True)
    while folder != tmp_path:
        with pytest.raises(
            PolicyError, match=r"holds runs\. Name one of them: \S+/run0, .*/run4, and 2 more\.$"
        ):
            resolve(folder)
        folder = folder.parent


def test_a_run_whose_checkpoint_is_damaged_names_it(tmp_path):
    checkpoint_of(tmp_path / "run")
    (tmp_path / "run/checkpoints/000100/pretrained_model/config.json").unlink()
    with pytest.raises(PolicyError, match=r"a run whose checkpoint '\S+/000100' has no pretrained"):
        resolve(tmp_path / "run")


def test_a_dataset_and_a_run_without_a_checkpoint_say_what_to_do(tmp_path):
    (tmp_path / "dataset/meta").mkdir(parents=True)
    (tmp_path / "dataset/meta/info.json").write_text("{}")
    with pytest.raises(PolicyError, match=r"is a dataset, .*roboverse train policy=act dataset=\S+/dataset$"):
        resolve(tmp_path / "dataset")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/config.yaml").write_text("")
    with pytest.raises(PolicyError, match=r"without a checkpoint yet\. .*: roboverse train run=\S+/run$"):
        resolve(tmp_path / "run")


def test_a_file_in_place_of_a_folder(tmp_path):
    (tmp_path / "model.pt").write_bytes(b"pickle")
    assert "is a file" in message(tmp_path / "model.pt")


@pytest.mark.parametrize(
    "name", ["config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json"]
)
def test_a_file_that_is_absent(broken, name):
    (broken / name).unlink()
    assert f"has no {name}" in message(broken)


@pytest.mark.parametrize(
    ("content", "learned", "refused"),
    [
        ({"type": "ppo", "task": "PickCube"}, ["PickCube"], "StackCube"),
        ({"type": "tdmpc2", "task": "a", "tasks": {"a": {}, "b": {}}}, ["a", "b"], "c"),
        ({"type": "ppo", "task": ""}, ["PickCube", "StackCube"], None),
        ({"type": "act"}, ["PickCube", "StackCube"], None),
    ],
)
def test_a_task_that_was_not_learned(tmp_path, content, learned, refused):
    (tmp_path / "config.json").write_text(json.dumps(content))
    for task in learned:
        check_learned(tmp_path, task)
    if refused:
        tasks = f"task{'s' * (len(learned) > 1)} {' and '.join(learned)}"
        said = f"'{content['type']}' learned the {tasks}, not {refused}. "
        said += f"Give task={' or task='.join(learned)}, or train it on {refused}.$"
        with pytest.raises(PolicyError, match=said):
            check_learned(tmp_path, refused)


def test_a_policy_that_reads_may_be_asked_for_a_task_that_it_did_not_learn(tmp_path):
    content = {"type": "multitask_act", "tasks": {"a": {}, "b": {}}, "input_features": {}}
    (tmp_path / "config.json").write_text(json.dumps(content))
    with pytest.raises(PolicyError, match="or evaluate it there nevertheless with other_tasks=true"):
        check_learned(tmp_path, "c")
    check_learned(tmp_path, "c", other_tasks=True)
    (tmp_path / "config.json").write_text(json.dumps({"type": "tdmpc2", "tasks": {"a": {}}}))
    with pytest.raises(PolicyError, match=r"not c\. Give task=a, or train it on c\.$"):
        check_learned(tmp_path, "c", other_tasks=True)


def test_statistics_that_are_absent(broken):
    (file,) = broken.glob("policy_preprocessor*.safetensors")
    file.unlink()
    assert f"has no {file.name}" in message(broken)


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["model.safetensors", "policy_postprocessor*.safetensors"])
@pytest.mark.parametrize("kept", [0, 5, 100])
def test_a_truncated_safetensors_file(broken, pattern, kept):
    (file,) = broken.glob(pattern)
    file.write_bytes(file.read_bytes()[:kept])
    assert f"{file.name}' ({kept} bytes) is truncated or not a safetensors file" in message(broken)


@pytest.mark.parametrize("pattern", ["model.safetensors", "policy_postprocessor*.safetensors"])
def test_a_flipped_byte_is_refused(broken, pattern):
    (file,) = broken.glob(pattern)
    flip_last_byte(file)
    assert f"{file.name}' is damaged, or was changed after it was saved: its SHA-256 is" in message(broken)
    (broken / "sha256.json").unlink()  # a checkpoint of lerobot-train has none
    policies.load(broken)


def test_hashes_that_are_no_json_are_refused(broken):
    (broken / "sha256.json").write_text("{")
    assert "sha256.json' is not valid JSON" in message(broken)


def flip_last_byte(path):
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("name", ["config.json", "policy_preprocessor.json"])
def test_json_that_is_cut_off(broken, name):
    (broken / name).write_text('{"type": "act", ')
    assert f"{name}' is not valid JSON" in message(broken)


def test_json_of_another_kind(broken):
    (broken / "config.json").write_text("[]")
    assert "must hold a JSON object, not a list" in message(broken)


@pytest.mark.parametrize("key", ["input_features", "output_features"])
@pytest.mark.parametrize("value", [None, {}])
def test_a_config_without_features(broken, key, value):
    content = json.loads((broken / "config.json").read_text())
    (broken / "config.json").write_text(json.dumps(content | {key: value}))
    with pytest.raises(PolicyError, match=r"config\.json' is not a configuration of policy 'act'"):
        policies.load(broken)


def test_a_config_without_a_type(broken):
    (broken / "config.json").write_text("{}")
    assert "does not say which policy it is" in message(broken)


def test_a_policy_that_is_not_registered(broken):
    edit(broken / "config.json", type="dreamer")
    with pytest.raises(UnknownNameError, match=r"Unknown policy 'dreamer'.* Valid: act, diffusion"):
        policies.load(broken)


def test_a_checkpoint_of_another_policy(broken):
    with pytest.raises(PolicyError, match=r"of policy 'act', not of 'diffusion'. Load it with policies.load"):
        policies.policy_class("diffusion").load(broken)


def test_a_config_key_that_is_unknown(broken):
    edit(broken / "config.json", colour="red")
    with pytest.raises(PolicyError, match=r"config.json' is not a configuration of policy 'act'.*colour"):
        policies.load(broken)


def test_weights_of_another_size(broken):
    edit(broken / "config.json", dim_feedforward=128)
    with pytest.raises(PolicyError, match=r"does not fit the configuration beside it.*linear1"):
        policies.load(broken)


def test_a_pipeline_cannot_import_a_class_of_its_choice(broken):
    content = json.loads((broken / "policy_preprocessor.json").read_text())
    content["steps"].append({"class": "subprocess.Popen", "config": {"args": ["true"]}})
    (broken / "policy_preprocessor.json").write_text(json.dumps(content))
    assert "has the step 'subprocess.Popen', which is not loaded. Valid: device_processor" in message(broken)


def test_a_pipeline_without_steps(broken):
    (broken / "policy_postprocessor.json").write_text('{"name": "x"}')
    assert "must hold a list 'steps'" in message(broken)


def test_a_failed_save_leaves_what_was_there(tmp_path):
    with atomic_directory(tmp_path / "folder") as staging:
        (staging / "a").write_text("old")
    with pytest.raises(OSError, match="disk"), atomic_directory(tmp_path / "folder") as staging:
        (staging / "a").write_text("half")
        raise OSError("disk full")
    assert (tmp_path / "folder" / "a").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def edit(path, **changes):
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize("key", ["class", "registry_name"])
def test_a_foreign_step_is_refused_before_anything_of_it_is_imported(broken, tmp_path, monkeypatch, key):
    """The module would leave a file behind if it were imported."""
    (tmp_path / "foreign_steps.py").write_text(
        f"import pathlib\npathlib.Path({str(tmp_path / 'imported')!r}).touch()\nclass Step: ...\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    path = broken / "policy_postprocessor.json"
    content = json.loads(path.read_text())
    content["steps"].insert(0, {key: "foreign_steps.Step", "config": {}})
    path.write_text(json.dumps(content))
    text = message(broken)
    assert f"'{path}' has the step 'foreign_steps.Step', which is not loaded. Valid: device_processor" in text
    assert not (tmp_path / "imported").exists()


def test_a_known_name_does_not_cover_a_foreign_class(broken):
    path = broken / "policy_preprocessor.json"
    content = json.loads(path.read_text())
    content["steps"][0]["class"] = "os.system"
    path.write_text(json.dumps(content))
    assert "which is not loaded" in message(broken)


def test_a_step_that_is_no_object(broken):
    (broken / "policy_preprocessor.json").write_text('{"steps": ["normalizer_processor"]}')
    assert "must hold a list 'steps'" in message(broken)


@pytest.mark.parametrize("name", ["act", "diffusion"])
def test_a_checkpoint_with_lerobots_batch_normalization_is_read(tmp_path, name):
    """LeRobot's defaults normalize by batch, and its files hold the counters of that."""
    from lerobot.configs import PolicyFeature
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.utils.feature_utils import dataset_to_policy_features

    known = dataset_to_policy_features({key: dict(value) for key, value in FEATURES.items()})
    image = PolicyFeature(type=known[IMAGE].type, shape=(3, 64, 64))  # 32 px leave one pixel
    inputs = {IMAGE: image, "observation.state": known["observation.state"]}
    model_class = get_policy_class(name)
    own = {"use_group_norm": False, "down_dims": (32, 64)} if name == "diffusion" else {"dim_feedforward": 64}
    config = model_class.config_class(
        input_features=inputs, output_features={"action": known["action"]}, device="cpu",
        pretrained_backbone_weights=None, push_to_hub=False, **own,
    )  # fmt: skip
    model = model_class(config)
    tensors = {
        key: {k: torch.as_tensor(v, dtype=torch.float32) for k, v in value.items()}
        for key, value in stats().items()
    }
    model.save_pretrained(tmp_path)
    for processor in make_pre_post_processors(config, dataset_stats=tensors):
        processor.save_pretrained(tmp_path)
    policy = policies.load(tmp_path)
    seen = observation(policy, 1)
    seen[IMAGE] = np.zeros((*seen[IMAGE].shape[:-3], 64, 64, 3), np.uint8)
    assert np.isfinite(policy.act(seen)).all()
