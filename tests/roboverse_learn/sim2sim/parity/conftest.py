import pytest

from envs.spec import EnvSpec
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.schema import CollectConfig, DemonstrationConfig
from roboverse_learn.data.dataset.recording import read_recordings


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """Two demonstrations of PickCube, recorded in MuJoCo; tests only read them."""
    config = CollectConfig(
        env=EnvSpec(image_size=32),
        datasets_dir=str(tmp_path_factory.mktemp("datasets")),
        collect=DemonstrationConfig(num_demos=2, num_workers=1, num_envs=2),
    )
    return collect_dataset(config).root


@pytest.fixture(scope="session")
def recordings(dataset):
    return read_recordings(dataset)
