"""One small run of the main command, on real physics and real pixels, that the tests here look at."""

import pytest

from roboverse_learn import cli
from tests.integration.main_run import TINY, MainRun


@pytest.fixture(scope="session")
def main_run(tmp_path_factory: pytest.TempPathFactory) -> MainRun:
    """Runs the main command once; tests must not change its files."""
    folder = tmp_path_factory.mktemp("loop")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert cli.main(["train", *TINY]) == 0
    return MainRun.at(folder)
