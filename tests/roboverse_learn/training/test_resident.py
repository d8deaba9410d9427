"""Training on a dataset that was written to disk."""

import pytest

import policies
from roboverse_learn.data import DatasetWriter, ResidentDataset
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.train import train
from tests.policies.examples import CONFIGS, LEARNED, generators
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, make_episode
from tests.sweeps import sweep


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "dataset"
    with DatasetWriter(root, fps=FPS, features=FEATURES, robot_type="panda") as writer:
        for index in range(3):
            writer.add_episode(make_episode(index, length=8))
    return ResidentDataset(root)


@pytest.mark.parametrize("name", sweep(LEARNED, {"act"}))
def test_trains_on_a_dataset_from_disk_and_acts_on_its_frames(name, dataset, tmp_path):
    policy = policies.create(name, dataset.info.features, dataset.info.stats, CONFIGS[name])
    assert set(policy.features) == {"observation.images.front", "observation.state", "action"}
    train_config = TrainConfig(steps=2, batch_size=4, num_threads=1, precision="fp32", log_every=1)
    result = train(policy, dataset, train_config, tmp_path)
    policy = policies.load(result.checkpoint)
    inputs = list(policy.model.config.input_features)
    seen = dataset.sample([0, 9], policy.delta_indices, keys=inputs, channels_last=True)
    observation = {key: seen[key].numpy() for key in inputs} | {"task": list(dataset.info.tasks) * 2}
    actions = policy.act(observation, generators(2))
    assert actions.shape == (2, policy.n_action_steps, 2)
