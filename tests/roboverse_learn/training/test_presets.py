"""Every policy that the YAML files can name is one that can be built, trained and timed."""

import pytest
import torch

import policies
from policies.lerobot_policy import policy_features
from roboverse_learn.config.compose import compose, configs_folder, preset_names
from roboverse_learn.training.imitation.optimizer import make_optimizer
from tests.policies.examples import LEARNED, generators, observation, stats

PAIRS = [(preset, policy) for preset in preset_names() for policy in LEARNED]


def task_presets():
    """Returns the tasks that a preset has something of its own for."""
    folder = configs_folder() / "task_preset"
    return sorted({str(path.parent.relative_to(folder)) for path in folder.rglob("*.yaml")})


def features(size):
    image = {"dtype": "video", "shape": (size, size, 3), "names": ["height", "width", "channels"]}
    vector = {"dtype": "float32", "shape": (9,), "names": None}
    return {"observation.images.front": image, "observation.state": vector, "action": vector}


def test_every_policy_has_its_file_and_every_file_its_policy():
    assert sorted(path.stem for path in (configs_folder() / "policy").glob("*.yaml")) == policies.names()
    for path in (configs_folder() / "policy_preset").glob("*.yaml"):
        preset, _, policy = path.stem.partition("_")
        assert preset in preset_names() and policy in policies.names(), path.name


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "name"), PAIRS)
def test_the_network_of_every_preset_builds(preset, name):
    config = compose("train", [f"preset={preset}", f"policy={name}"])
    cls = policies.policy_class(name)
    inputs, outputs = policy_features(features(config.env.image_size))
    with torch.device("meta"):  # shapes without numbers: the full networks are large
        model = cls.make_model(cls.lerobot_config(config.policy, inputs, outputs, "cpu"))
    policy = cls(model, cls.lerobot_processors(model.config, stats()))
    assert 1 <= policy.n_action_steps <= len(policy.delta_indices["action"])
    assert policy.n_params > 4e5
    trained = sum(len(group["params"]) for group in make_optimizer(policy, config.train).param_groups)
    assert trained == sum(parameter.requires_grad for parameter in model.parameters())
    assert config.train.warmup_steps < config.train.steps
    assert config.train.save_every <= config.train.steps


@pytest.mark.parametrize("task", ["PickCube", *task_presets()])
@pytest.mark.parametrize("name", LEARNED)
def test_quick_training_ends_by_steps_and_never_by_the_clock(name, task):
    """A slow machine learns the same as a fast one."""
    assert compose("train", [f"policy={name}", "preset=quick", f"task={task}"]).train.time_limit_s is None


@pytest.mark.parametrize("name", LEARNED)
def test_the_quick_policies_act(name):
    config = compose("train", ["preset=quick", f"policy={name}"])
    policy = policies.create(name, features(32), stats(), config.policy)
    actions = policy.act(observation(policy, 1), generators(1))
    assert actions.shape == (1, config.policy.n_action_steps, 9)
    assert policy.n_params < 30e6
