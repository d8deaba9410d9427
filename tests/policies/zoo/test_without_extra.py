"""``policy=lerobot`` with VQ-BeT, a type that needs no extra: how it is made, trained, saved and loaded."""

import copy
from typing import Any

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import PolicyError
from policies import checkpoint
from policies.zoo.config import LeRobotConfig
from roboverse_learn.config.compose import compose
from tests.policies.examples import FEATURES, IMAGE, SIZE, generators, observation, stats
from tests.policies.zoo.tiny import VQBET


@pytest.fixture(scope="module")
def vqbet():
    return policies.create("lerobot", FEATURES, stats(), LeRobotConfig(type="vqbet", settings=VQBET))


@pytest.mark.slow
def test_frames_that_begin_no_sample_are_those_that_are_given():
    def dropped(**given: Any) -> int:
        config = LeRobotConfig(type="vqbet", settings=VQBET | given)
        return policies.create("lerobot", FEATURES, stats(), config).drop_last_frames

    assert dropped() == 0 and dropped(drop_n_last_frames=0) == 0 and dropped(drop_n_last_frames=3) == 3
    config = compose("train", ["policy=lerobot", "type=groot", "policy.drop_n_last_frames=0"])
    assert config.policy.settings == {"drop_n_last_frames": 0}
    for wrong in (-1, 0.5, "all"):
        with pytest.raises(PolicyError, match=f"drop_n_last_frames must be a whole number .*, given {wrong}"):
            LeRobotConfig(type="groot", settings={"drop_n_last_frames": wrong})


@pytest.mark.slow
def test_noise_on_the_state_is_in_deviations_of_the_demonstrations_and_in_no_action(vqbet):
    given = stats()
    given["observation.state"]["std"] = np.linspace(0.0, 2.0, 9, dtype=np.float32)
    settings = VQBET | {"state_noise": 0.5}
    noisy = policies.create("lerobot", FEATURES, given, LeRobotConfig(type="vqbet", settings=settings))
    seen: dict[str, torch.Tensor] = {}
    noisy.preprocess = lambda batch: seen.update(batch) or batch
    state = torch.zeros(2000, 9)
    noisy.objective().normalizer({"observation.state": state})
    spread = seen["observation.state"].std(0)
    torch.testing.assert_close(spread, 0.5 * torch.linspace(0.0, 2.0, 9), rtol=0.1, atol=0.0)
    assert not state.any()
    plain = policies.create("lerobot", FEATURES, given, LeRobotConfig(type="vqbet", settings=VQBET))
    noisy = policies.create("lerobot", FEATURES, given, LeRobotConfig(type="vqbet", settings=settings))
    noisy.model.load_state_dict(plain.model.state_dict())
    both = [policy.act(observation(policy, 2), generators(2)) for policy in (noisy, plain)]
    np.testing.assert_array_equal(*both)


@pytest.mark.slow
def test_noise_on_the_state_is_in_no_file_of_a_checkpoint_and_given_anew_to_go_on_with_it(tmp_path):
    config = LeRobotConfig(type="vqbet", settings=VQBET | {"state_noise": 0.5})
    policies.create("lerobot", FEATURES, stats(), config).save(tmp_path / "noisy")
    assert not any("state_noise" in path.read_text() for path in (tmp_path / "noisy").glob("*.json"))
    states = {"observation.state": torch.zeros(2, 9)}
    for given, moved in (({}, False), ({"state_noise": 0.1}, True)):
        config = LeRobotConfig(path=str(tmp_path / "noisy"), settings=given)
        policy = policies.create("lerobot", FEATURES, stats(), config)
        policy.preprocess = dict
        assert bool(policy.objective().normalizer(states)["observation.state"].any()) is moved


def test_noise_on_the_state_is_a_setting_of_a_type_that_lacks_it_in_lerobot():
    config = compose("train", ["policy=lerobot", "type=smolvla", "policy.state_noise=0.1"])
    assert config.policy.settings == {"state_noise": 0.1}
    for wrong in (-0.1, float("inf"), float("nan"), "much"):
        with pytest.raises(PolicyError, match=rf"state_noise must be 0 \(off\) or more, given {wrong}"):
            LeRobotConfig(type="smolvla", settings={"state_noise": wrong})


@pytest.mark.slow
def test_a_type_without_language_is_made_saved_and_loaded(vqbet, tmp_path):
    seen = observation(vqbet, 2)
    actions = vqbet.act(seen, generators(2))
    assert actions.shape == (2, vqbet.n_action_steps, 9) and np.isfinite(actions).all()
    vqbet.save(tmp_path / "vqbet")
    assert checkpoint.policy_type(tmp_path / "vqbet") == "lerobot"
    loaded = policies.load(tmp_path / "vqbet")
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), actions)
    rows = {key: value[1:] for key, value in seen.items()}
    np.testing.assert_array_equal(vqbet.act(rows, generators(2)[1:]), actions[1:])


@pytest.mark.slow
def test_the_loss_is_that_of_lerobot(vqbet):
    from tests.policies.test_closed_forms import raw_batch_of

    batch, twin = raw_batch_of(vqbet, 3), copy.deepcopy(vqbet.model)  # it counts its steps
    torch.manual_seed(0)
    loss, _ = vqbet.objective()(dict(batch))
    torch.manual_seed(0)
    expected, _ = twin.forward(vqbet.preprocess(batch))
    assert loss.item() == expected.item()
    assert np.isfinite(loss.item()) and loss.requires_grad


def test_a_cameras_new_name_is_saved_and_mapped(tmp_path):
    config = LeRobotConfig(type="vqbet", settings=VQBET, rename_map={"front": "camera1"})
    policy = policies.create("lerobot", FEATURES, stats(), config)
    assert list(policy.model.config.image_features) == ["observation.images.camera1"]
    assert IMAGE in policy.shapes
    policy.save(tmp_path / "renamed")
    assert checkpoint.seen_cameras(tmp_path / "renamed") == {"front": SIZE}
    loaded = policies.load(tmp_path / "renamed")
    seen = observation(policy, 1)
    np.testing.assert_array_equal(loaded.act(seen, generators(1)), policy.act(seen, generators(1)))
    loaded.see(["top"], {"top": "camera1"})
    moved = {key.replace("front", "top"): value for key, value in seen.items()}
    np.testing.assert_array_equal(loaded.act(moved, generators(1)), policy.act(seen, generators(1)))
    with pytest.raises(PolicyError, match=r"cameras camera1, and the task has wrist: camera1 is missing"):
        loaded.see(["wrist"], {})


def test_a_preset_of_lerobot_decides_the_optimizer_or_is_an_error(vqbet):
    from roboverse_learn.training.config import TrainConfig

    vqbet._preset = True
    changed = vqbet.training_config(TrainConfig(steps=5))
    assert (changed.lr, changed.betas, changed.steps) == (1e-4, (0.95, 0.999), 5)
    with pytest.raises(PolicyError, match=r"train.lr would have no effect.*policy.optimizer_lr=1e-5, or add"):
        vqbet.training_config(TrainConfig(lr=3e-4))
    vqbet._preset = False
    assert vqbet.training_config(TrainConfig(lr=3e-4)).lr == 3e-4
