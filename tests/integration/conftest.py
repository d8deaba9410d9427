"""One small run of the main command, on real physics and real pixels, that the tests here look at."""

from collections.abc import Callable

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


@pytest.fixture
def error(capsys: pytest.CaptureFixture[str]) -> Callable[[list[str]], str]:
    """Returns a function that runs a command which must fail, and gives its message."""

    def run(words: list[str]) -> str:
        capsys.readouterr()
        assert cli.main(words) == 2
        said = capsys.readouterr()
        assert "Traceback" not in said.err and said.err.count("error: ") == 1, said.err
        return said.err[said.err.index("error: ") :]

    return run
