"""Tiny VLAs of every kind, in one process: training, adapters, a folder that moves, an episode."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch._dynamo.utils import counters

import policies
from envs.core.errors import ConfigError, PolicyError
from policies.zoo.config import LeRobotConfig, PeftConfig
from policies.zoo.preflight import packages_of_type
from roboverse_learn.training.imitation.fast_objective import fast_objective
from tests.policies.examples import FEATURES, IMAGE, SIZE, generators, stats
from tests.policies.training_steps import batch, steps
from tests.policies.zoo import tiny
from tests.policies.zoo.needs import OPENVLA, needs, of_types

LIBRARY_TEST = [
    pytest.mark.long,
    *(  # of transformers and peft
        pytest.mark.filterwarnings(f"ignore::{kind}Warning")
        for kind in ("User", "Future", "Deprecation", "Runtime", "Resource")
    ),
]
"""Marks of a test that imports transformers; what a type needs is a mark of its parameter."""

pytestmark = LIBRARY_TEST

SMOLVLA = of_types("smolvla")
TARGETS = {  # layers with adapters, where LeRobot names none
    "multi_task_dit": r".*qkv_proj",
    "xvla": r".*(q_proj|v_proj)",
}
EVALUATION = ("task=PickCube", "levels=[0]", "splits=[test]", "episodes=1", "videos=0", f"image_size={SIZE}")


def with_quantiles() -> dict:
    found = stats()
    for of_key in found.values():
        of_key |= {"q01": of_key["min"], "q99": of_key["max"]}
    return found


def create(**config):
    return policies.create("lerobot", FEATURES, with_quantiles(), LeRobotConfig(**config))


def step(policy, lr: float = 1e-3, count: int = 1) -> list[float]:
    return steps(policy, tiny.WORDS, lr, count)


def observation(policy, n: int = 2, words=tiny.WORDS) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    time = (policy.n_obs_steps,) if policy.n_obs_steps > 1 else ()
    return {
        IMAGE: rng.integers(0, 256, (n, *time, SIZE, SIZE, 3), np.uint8),
        "observation.state": rng.normal(size=(n, *time, 9)).astype(np.float32),
        "task": np.array([[word] * time[0] if time else word for word in words[:n]]),
    }


@pytest.fixture(scope="module", params=of_types("smolvla", "multi_task_dit", "xvla", "pi0", "pi05"))
def trained(request, tmp_path_factory):
    """A policy after a step, and its checkpoint, which moved and whose backbone and tokenizer are gone."""
    name, folder = request.param, tmp_path_factory.mktemp(request.param)
    with pytest.MonkeyPatch.context() as patch:
        extra = {}
        if name.startswith("pi"):
            settings, extra = tiny.paligemma(folder / "backbone"), {"tokenizer": str(folder / "backbone")}
            tiny.shrink_pi(patch, f"lerobot.policies.{name}.modeling_{name}")
        else:
            settings = getattr(tiny, name)(folder / "backbone")
        policy = create(type=name, settings=settings, **extra)
        losses = step(policy, count=2)
        policy.save(folder / "run" / "pretrained_model")
        for path in [path for path in folder.iterdir() if path.name.startswith("backbone")]:
            shutil.move(path, folder / f"gone_{path.name}")
        shutil.move(folder / "run", folder / "moved")
        checkpoint = folder / "moved" / "pretrained_model"
        yield SimpleNamespace(name=name, policy=policy, losses=losses, checkpoint=checkpoint, folder=folder)


def test_a_step_changes_the_loss(trained):
    assert np.isfinite(trained.losses).all()
    assert trained.losses[1] < trained.losses[0]


def test_a_checkpoint_that_moved_acts_the_same(trained):
    seen = observation(trained.policy)
    expected = trained.policy.act(seen, generators(2))
    assert expected.shape == (2, trained.policy.n_action_steps, 9) and np.isfinite(expected).all()
    loaded = policies.load(trained.checkpoint)
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), expected)
    loaded.save(trained.folder / "again")
    np.testing.assert_array_equal(policies.load(trained.folder / "again").act(seen, generators(2)), expected)


def test_a_checkpoint_names_its_backbone_as_before(trained):
    """So that LeRobot's own programs find what they would."""
    saved = (trained.checkpoint / "config.json").read_text()
    assert str(trained.checkpoint) not in saved
    index = json.loads((trained.checkpoint / "assets.json").read_text())
    for name, copy in index.items():
        assert str(trained.folder) in name and not Path(copy).is_absolute()
        assert (trained.checkpoint / copy / "tokenizer.json").is_file()
    weights = [path.name for path in trained.checkpoint.rglob("*.safetensors") if "step_" not in path.name]
    assert weights == ["model.safetensors"]


def test_lerobot_acts_the_same_from_our_checkpoint(trained):
    """Where the names that LeRobot looks up are still there."""
    if trained.policy.n_obs_steps > 1:
        return  # LeRobot fills the history of such a policy by itself, step after step
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    backbone = trained.folder / "backbone"
    backbone.symlink_to(trained.folder / "gone_backbone")
    config = PreTrainedConfig.from_pretrained(trained.checkpoint)
    model = get_policy_class(config.type).from_pretrained(trained.checkpoint, config=config)
    before, after = make_pre_post_processors(config, pretrained_path=str(trained.checkpoint))
    seen = observation(trained.policy, 1)
    batch = {key: torch.from_numpy(seen[key]) for key in (IMAGE, "observation.state")}
    batch[IMAGE] = batch[IMAGE].movedim(-1, -3).contiguous().float() / 255
    torch.manual_seed(5)
    with torch.inference_mode():
        chunk = after(model.predict_action_chunk(before(batch | {"task": [str(seen["task"][0])]}))[..., :9])
    torch.manual_seed(5)
    ours = trained.policy.act(seen)
    backbone.unlink()
    np.testing.assert_allclose(ours, chunk[:, : config.n_action_steps].float().numpy(), rtol=1e-4, atol=1e-5)


def test_actions_depend_on_the_instruction_and_on_no_neighbour(trained):
    policy = trained.policy
    two = policy.act(observation(policy), generators(2))
    other = policy.act(observation(policy, words=("open the drawer", tiny.WORDS[1])), generators(2))
    assert not np.array_equal(two[0], other[0])
    np.testing.assert_array_equal(two[1], other[1])


@needs("peft")
def test_adapters_train_alone_and_load_again(trained):
    check_adapters(trained, TARGETS.get(trained.name), trained.folder)


def check_adapters(trained, layers, folder: Path) -> None:
    peft = PeftConfig(method_type="LORA", r=2, target_modules=layers)
    policy = create(path=str(trained.checkpoint), peft=peft)
    before = {key: value.clone() for key, value in policy.network.state_dict().items()}
    losses = step(policy, lr=1e-2, count=3)
    assert np.isfinite(losses).all() and len({*losses}) > 1
    after = policy.network.state_dict()
    changed = {key for key in before if not before[key].equal(after[key])}
    assert changed and all("lora_" in key for key in changed)
    seen = observation(policy)
    expected = policy.act(seen, generators(2))
    policy.save(folder / "lora")
    moved = folder / "lora_moved"
    shutil.move(folder / "lora", moved)
    size = (moved / "adapter_model.safetensors").stat().st_size
    assert size < (trained.checkpoint / "model.safetensors").stat().st_size / 2
    loaded = policies.load(moved)
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), expected)
    assert not np.array_equal(expected, trained.policy.act(seen, generators(2)))


@needs("peft")
@pytest.mark.parametrize("trained", SMOLVLA, indirect=True)
def test_lerobot_loads_our_adapters(trained):
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import make_policy

    policy = create(path=str(trained.checkpoint), peft=PeftConfig(method_type="LORA", r=2))
    step(policy, lr=1e-2)
    folder = trained.folder / "for_lerobot"
    policy.save(folder)
    backbone = trained.folder / "backbone"
    backbone.symlink_to(trained.folder / "gone_backbone")
    config = PreTrainedConfig.from_pretrained(folder)
    config.pretrained_path = folder
    loaded = make_policy(config, ds_meta=SimpleNamespace(features=FEATURES, stats=stats()))
    backbone.unlink()
    found, expected = loaded.state_dict(), policy.model.state_dict()
    assert found.keys() == expected.keys()
    assert all(torch.equal(found[key].float(), expected[key].float()) for key in found)


def test_learning_rates_have_lerobots_shares(trained):
    groups = trained.policy.parameter_groups()
    expected = {"multi_task_dit": {1.0, 0.1}, "xvla": {1.0, 0.1}}.get(trained.name, {1.0})
    assert {round(share, 6) for _, share in groups} == expected
    trained_ones = [each for each in trained.policy.model.parameters() if each.requires_grad]
    assert sum(len(members) for members, _ in groups) == len(trained_ones)


@pytest.mark.parametrize("trained", SMOLVLA, indirect=True)
def test_compiled_blocks_leave_the_gradients_and_the_policy_as_they_are(trained, caplog):
    policy = policies.load(trained.checkpoint)
    policy.instructions = tiny.WORDS
    seen = observation(policy)
    before = policy.act(seen, generators(2))
    policy.begin_training()
    batches, graphs = [batch(policy), batch(policy)], counters["stats"]["unique_graphs"]
    fast_objective(policy, batches, "fp32", compile=True, cuda_graphs=False)  # compares the gradients
    policy.end_training()
    assert counters["stats"]["unique_graphs"] > graphs
    assert "changes the gradient" not in caplog.text
    graphs = counters["stats"]["unique_graphs"]
    np.testing.assert_array_equal(policy.act(seen, generators(2)), before)
    assert counters["stats"]["unique_graphs"] == graphs


def test_absent_weights_are_an_error(trained, tmp_path):
    from safetensors.torch import load_file, save_file

    copy = shutil.copytree(trained.checkpoint, tmp_path / "copy")
    tensors = load_file(copy / "model.safetensors")
    lost = sorted(tensors)[0]
    save_file({key: value for key, value in tensors.items() if key != lost}, copy / "model.safetensors")
    (copy / "sha256.json").unlink()
    with pytest.raises(PolicyError, match=r"does not hold the weights of this policy: [12] of"):
        policies.load(copy)
    (copy / "model.safetensors").unlink()
    with pytest.raises(PolicyError, match=r"has no model\.safetensors"):
        policies.load(copy)


def evaluate(*words: str):
    from roboverse_learn.config.compose import compose
    from roboverse_learn.evaluate import evaluate_all

    (found,) = evaluate_all(compose("evaluate", [*EVALUATION, *words]))
    return found.result


def test_an_episode_is_evaluated_by_the_command(trained, tmp_path):
    result = evaluate(f"policy.path={trained.checkpoint}", f"results_dir={tmp_path}")
    assert result.policy == trained.name
    assert [record.length for record in result.records] == [100] or result.records[0].success


@pytest.mark.parametrize("trained", SMOLVLA, indirect=True)
def test_a_renamed_camera_is_mapped_and_a_wrong_one_is_one_sentence(trained, tmp_path):
    config = json.loads((trained.checkpoint / "config.json").read_text())
    copy = shutil.copytree(trained.checkpoint, tmp_path / "copy")
    features = config["input_features"]
    features["observation.images.camera1"] = features.pop(IMAGE)
    (copy / "config.json").write_text(json.dumps(config))
    with pytest.raises(PolicyError, match=r"sees the cameras camera1, and PickCube has front.*front:camera1"):
        evaluate(f"checkpoint={copy}", f"results_dir={tmp_path}")
    result = evaluate(f"checkpoint={copy}", f"results_dir={tmp_path}", "rename_map={front:camera1}")
    assert len(result.records) == 1 and result.env.cameras == ("front",)


@needs(*packages_of_type("smolvla"), "peft")
def test_the_main_command_trains_a_vla_and_then_its_adapters(tmp_path, monkeypatch, capsys):
    from roboverse_learn import cli
    from tests.integration.main_run import TINY

    monkeypatch.chdir(tmp_path)
    settings = tiny.smolvla(tmp_path / "vlm")
    words = [word for word in TINY if not word.startswith(("policy", "train.", "run=", "levels"))]
    own = [f"policy.{key}={str(value).replace(' ', '')}" for key, value in settings.items()]
    shared = ["policy=lerobot", *words, "levels=[0]", "train.steps=2", "train.batch_size=2", "slow_ok=true"]
    assert cli.main(["train", "type=smolvla", *shared, *own, "run=full"]) == 0
    assert cli.main(
        ["train", *shared, "policy.path=full", "peft.method_type=LORA", "peft.r=2", "run=adapted"]
    ) == 0, capsys.readouterr().err  # fmt: skip
    last = tmp_path / "adapted" / "checkpoints" / "last" / "pretrained_model"
    assert (last / "adapter_model.safetensors").is_file() and not (last / "model.safetensors").exists()
    assert cli.main(["train", "run=adapted", "train.steps=3", "slow_ok=true", "policy=lerobot"]) == 0
    assert last.resolve().parent.name == "000003"
    assert list(tmp_path.glob("results/v*/PickCube/smolvla/*.json"))


@needs(*packages_of_type("smolvla"))
@pytest.mark.parametrize("name", ["full", pytest.param("lora", marks=needs("peft"))])
def test_a_step_is_compared_to_lerobots_on_the_same_losses(name):
    from roboverse_learn.speed.vla import Vla

    found = Vla(device="cpu").sized().step(name, bf16=True)
    assert found.ours_s > 0 < found.baseline_s and f"SmolVLA ({name})" in found.name


@needs(*packages_of_type("smolvla"))
def test_the_backbone_of_the_comparison_has_the_published_size(tmp_path):
    from transformers import AutoConfig, SmolVLMForConditionalGeneration

    from roboverse_learn.speed.vla import REAL
    from roboverse_learn.training.imitation.small_backbone import write_smolvlm

    write_smolvlm(tmp_path, REAL, list(tiny.WORDS))
    with torch.device("meta"):
        model = SmolVLMForConditionalGeneration(AutoConfig.from_pretrained(tmp_path))
    assert sum(each.numel() for each in model.parameters()) == pytest.approx(507e6, rel=0.02)


# --- OpenVLA ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def published(tmp_path_factory) -> Path:
    """A tiny checkpoint as OpenVLA's authors publish theirs."""
    folder = tmp_path_factory.mktemp("openvla") / "published"
    tiny.openvla(folder)
    return folder


def create_openvla(published: Path, **config):
    from policies.openvla.config import OpenVlaConfig

    return policies.create(
        "openvla", FEATURES, with_quantiles(), OpenVlaConfig(path=str(published), **config)
    )


@needs(*OPENVLA)
def test_openvla_answers_with_the_likeliest_action_tokens(published):
    """A cache that drops the image gives every image the same action; the full pass knows none."""
    policy = create_openvla(published)
    seen = policy.preprocess(policy._to_tensors(observation(policy)))
    network, answers = policy.network, []
    for prompt, pixels in zip(seen["prompts"], seen["pixels"], strict=True):
        tokens = torch.tensor([prompt])
        for _ in range(9):
            logits = network(tokens, torch.ones_like(tokens), pixels[None])
            tokens = torch.cat([tokens, logits[:, -1:].argmax(-1)], 1)
        answers.append(tokens[0, len(prompt) :])
    expected = policy.scale.restore(policy.tokens.decode(torch.stack(answers)))[:, None].numpy()
    np.testing.assert_array_equal(policy.act(observation(policy)), expected)


@needs(*OPENVLA)
@torch.no_grad()
def test_openvla_sees_the_image_and_reads_the_instruction(published):
    policy = create_openvla(published)
    network, pixels = policy.network, torch.randn(2, 6, 32, 32)
    tokens = torch.tensor(policy.preprocess(policy._to_tensors(observation(policy, 1)))["prompts"])
    both = network(tokens.expand(2, -1), torch.ones(2, tokens.shape[1], dtype=torch.long), pixels)
    assert not torch.allclose(both[0, -1], both[1, -1], atol=1e-4)
    assert torch.equal(both[0, :1], both[1, :1])  # the first token is before the image
    other = tokens.clone()
    other[0, 5] += 1
    again = network(other, torch.ones_like(other), pixels[:1])
    assert not torch.allclose(again[0, -1], both[0, -1], atol=1e-4)


@needs(*OPENVLA)
def test_openvla_learns_a_batch_and_moves(published, tmp_path):
    policy = create_openvla(published)
    losses = step(policy, lr=3e-3, count=30)
    assert losses[-1] < losses[0] / 2
    seen = observation(policy)
    expected = policy.act(seen)
    policy.save(tmp_path / "saved")
    shutil.move(tmp_path / "saved", tmp_path / "moved")
    np.testing.assert_array_equal(policies.load(tmp_path / "moved").act(seen), expected)
    saved = json.loads((tmp_path / "moved" / "config.json").read_text())
    assert saved["norm_stats"]["roboverse"]["action"]["q01"] == pytest.approx(
        stats()["action"]["min"].tolist()
    )


@needs(*OPENVLA, "peft")
def test_openvla_adapters_are_saved_alone_and_evaluated_by_the_command(published, tmp_path):
    peft = PeftConfig(method_type="LORA", r=2, target_modules="all-linear")
    policy = create_openvla(published, peft=peft)
    step(policy, lr=1e-2, count=3)
    seen = observation(policy)
    expected = policy.act(seen)
    policy.save(tmp_path / "saved")
    shutil.move(tmp_path / "saved", tmp_path / "lora")
    assert not (tmp_path / "lora" / "model.safetensors").exists()
    np.testing.assert_array_equal(policies.load(tmp_path / "lora").act(seen), expected)
    result = evaluate("policy=openvla", f"path={tmp_path / 'lora'}", f"results_dir={tmp_path}")
    assert result.policy == "openvla" and len(result.records) == 1


@needs(*OPENVLA)
def test_openvla_with_actions_of_another_width_is_one_sentence(published, tmp_path):
    policy = create_openvla(published)
    policy.save(tmp_path / "saved")
    path = tmp_path / "saved" / "config.json"
    config = json.loads(path.read_text())
    config["output_features"]["action"]["shape"] = [7]
    path.write_text(json.dumps(config))
    with pytest.raises(
        ConfigError, match=r"actions have 7 numbers, and in PickCube it is 9 .*of robot franka"
    ):
        evaluate(f"checkpoint={tmp_path / 'saved'}", f"results_dir={tmp_path}")
