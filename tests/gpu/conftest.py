"""The tests that need a GPU: ``.ci/gpu`` runs them, in about three minutes.

Those marked ``long`` take minutes more and run only when selected: ``pytest -m 'gpu and long' tests/gpu``.
"""

import sys

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Shows warnings as warnings: the packages of a GPU machine are of its own versions."""
    if "gpu" in config.option.markexpr:
        config.addinivalue_line("filterwarnings", "default")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    import torch  # not before warnings are shown as warnings

    if not torch.cuda.is_available():
        pytest.skip("needs an NVIDIA GPU")


@pytest.fixture(autouse=True)
def fresh_state():
    """Drops the compiled code and the device of the tests before: both are kept by the process."""
    yield
    if "torch._dynamo" in sys.modules:
        sys.modules["torch"].compiler.reset()
    if "accelerate.state" in sys.modules:
        sys.modules["accelerate.state"].AcceleratorState._reset_state(reset_partial_state=True)
