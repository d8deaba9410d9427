from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def pick_cube_demos(tmp_path_factory) -> Path:
    """A dataset of four demonstrations of PickCube without images; tests only read it."""
    from tests.roboverse_learn.data.augmentation.expert_demos import write_demos

    return write_demos(tmp_path_factory.mktemp("sources") / "PickCube", "PickCube", 4)
