"""What ``lerobot-train`` makes of our dataset, as LeRobot normalizes by default, acts and is evaluated here.

π0, π0.5, π0-FAST and FastWAM are left out: no setting of LeRobot's makes them small or names a backbone.
"""

import json
import os
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import policies
from benchmark.records import Result
from benchmark.results import read_result
from policies.checkpoint import ADAPTERS, WEIGHTS, policy_label
from roboverse_learn import cli
from tests import imported_process
from tests.integration.main_run import MainRun
from tests.policies.zoo import test_vla as vla
from tests.policies.zoo import tiny, tiny_more
from tests.policies.zoo.needs import needs, of_types

pytestmark = vla.LIBRARY_TEST

IMAGE = "observation.images.front"
NOTHING_FETCHED = {"pretrained_backbone_weights": None}
SETTINGS: dict[str, dict[str, Any]] = {
    "act": NOTHING_FETCHED,
    # Batches cannot be normalized by themselves where nothing but one pixel is left of a small image.
    "diffusion": NOTHING_FETCHED | {
        "use_group_norm": True, "down_dims": [32, 64], "num_inference_steps": 2,
    },
    "vqbet": NOTHING_FETCHED | {"use_group_norm": True, "crop_shape": None},
    "keypoint_act": {"dim_model": 32, "n_heads": 2, "dim_feedforward": 32},
    "keypoint_diffusion": {
        "horizon": 8, "n_action_steps": 4, "down_dims": [32, 64], "num_inference_steps": 2,
    },
    "multitask_act": {},
}  # fmt: skip
"""Settings of types that need no backbone of others; the rest is LeRobot's default."""

TYPES = (
    *("act", "diffusion", "vqbet", "multi_task_dit", "smolvla", "xvla", "eo1", "evo1", "vla_jepa"),
    "molmoact2",
)
OURS = ("keypoint_act", "keypoint_diffusion", "multitask_act")
"""Types that our plugin brings to LeRobot."""

ROOT = Path(__file__).resolve().parents[2]


def settings(name: str, folder: Path) -> dict[str, Any]:
    """Returns what keeps a type small and off the network."""
    if name in SETTINGS:
        return SETTINGS[name]
    made = (getattr(tiny, name, None) or getattr(tiny_more, name))(folder)
    return {key: value for key, value in made.items() if key != "normalization_mapping"}


def train(folder: Path, dataset: Path, *words: str) -> Path:
    """Takes two steps of ``lerobot-train``; returns the checkpoint."""
    given = [
        *("--policy.device=cpu", "--policy.push_to_hub=false", "--dataset.repo_id=local/pick_cube"),
        *(f"--dataset.root={dataset}", "--output_dir=trained", "--steps=2", "--save_freq=2"),
        *("--batch_size=2", "--num_workers=0", "--wandb.enable=false"),
    ]
    path = filter(None, [os.environ.get("PYTHONPATH")])
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "PYTHONPATH": os.pathsep.join([str(ROOT), *path])}
    program = imported_process.installed("lerobot-train")
    done = imported_process.run(program, *words, *given, folder=folder, env=environment)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return folder / "trained/checkpoints/last/pretrained_model"


def evaluate(checkpoint: Path, results: Path) -> Result:
    """Evaluates one episode by our command; returns the result."""
    words = ["task=PickCube", "levels=[0]", "splits=[test]", "episodes=1", "videos=0", "device=cpu"]
    assert cli.main(["evaluate", f"checkpoint={checkpoint}", f"results_dir={results}", *words]) == 0
    (path,) = (results / "v2/PickCube" / policy_label(checkpoint)).glob("*.json")
    return read_result(path)


@pytest.fixture(scope="module", params=[*of_types(*TYPES), *OURS])
def trained(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, main_run: MainRun
) -> SimpleNamespace:
    """A policy type and its checkpoint after two steps of ``lerobot-train``."""
    name, folder = request.param, tmp_path_factory.mktemp(request.param)
    words = [f"--policy.type={name}", "--policy.discover_packages_path=envs.lerobot"]
    for key, value in settings(name, folder / "backbone").items():
        words.append(f"--policy.{key}={value if isinstance(value, str) else json.dumps(value)}")
    return SimpleNamespace(name=name, checkpoint=train(folder, main_run.dataset, *words))


def test_the_checkpoint_normalizes_as_lerobot_does_by_default(trained: SimpleNamespace) -> None:
    saved = json.loads((trained.checkpoint / "config.json").read_text())
    assert saved["type"] == trained.name
    kind = type(policies.load(trained.checkpoint).model.config)
    # Of EO-1, a configuration itself cannot be made: it would fetch its backbone's.
    field: Any = next(each for each in fields(kind) if each.name == "normalization_mapping")
    default = {key: mode.value for key, mode in field.default_factory().items()}
    assert saved["normalization_mapping"] == default


def test_our_command_evaluates_it(trained: SimpleNamespace, tmp_path: Path) -> None:
    result = evaluate(trained.checkpoint, tmp_path)
    assert (len(result.records), result.env.image_size) == (1, 32)
    assert result.policy == policy_label(trained.checkpoint)
    assert result.train_level is None  # nothing says what it was trained on


@needs("peft")
@pytest.mark.parametrize("trained", of_types("multi_task_dit"), indirect=True)
def test_our_command_evaluates_the_adapters_that_lerobot_trains_on_it(
    trained: SimpleNamespace, main_run: MainRun, tmp_path: Path
) -> None:
    checkpoint = train(
        tmp_path,
        main_run.dataset,
        *(f"--policy.path={trained.checkpoint}", "--peft.method_type=LORA", "--peft.r=2"),
        "--peft.target_modules=.*qkv_proj",
    )
    assert (checkpoint / ADAPTERS).is_file() and not (checkpoint / WEIGHTS).exists()
    assert len(evaluate(checkpoint, tmp_path / "results").records) == 1


def test_it_acts_here_as_in_lerobot(trained: SimpleNamespace) -> None:
    """The first action of an episode; a policy that looks back sees its first observation until then."""
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    ours = policies.load(trained.checkpoint)
    config = PreTrainedConfig.from_pretrained(trained.checkpoint)
    theirs = get_policy_class(config.type).from_pretrained(trained.checkpoint, config=config).eval()
    before, after = make_pre_post_processors(config, pretrained_path=str(trained.checkpoint))
    rng = np.random.default_rng(0)
    state = rng.normal(size=(1, 9)).astype(np.float32)
    image = rng.integers(0, 256, (1, 32, 32, 3), dtype=np.uint8)
    words = "pick up the red cube"
    pixels = torch.from_numpy(image).permute(0, 3, 1, 2).float() / 255
    batch = {"observation.state": torch.from_numpy(state), IMAGE: pixels, "task": [words]}
    theirs.reset()
    torch.manual_seed(5)
    with torch.inference_mode():
        expected = after(theirs.select_action(before(batch))).numpy()
    seen: dict[str, Any] = {"observation.state": state, IMAGE: image, "task": np.array([words])}
    if ours.n_obs_steps > 1:
        seen = {key: np.repeat(value[:, None], ours.n_obs_steps, axis=1) for key, value in seen.items()}
    torch.manual_seed(5)
    np.testing.assert_allclose(ours.act(seen)[:, 0], expected[:, :9], rtol=1e-4, atol=1e-5)
