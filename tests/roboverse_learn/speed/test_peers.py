"""Another project's environment, which a small module of its name stands for. No ratio is asserted."""

import sys
from pathlib import Path

import pytest

from envs.core.errors import MissingExtraError, SimulatorError
from roboverse_learn.speed.peers import Peer, Peers

pytestmark = pytest.mark.slow

ROBOSUITE = """
import numpy as np

class Env:
    action_spec = np.zeros(7), np.ones(7)
    left = {left}
    def reset(self): print("a line of the package")
    def step(self, action):
        assert action.shape == (7,)
        self.left -= 1
        if self.left < 0: raise RuntimeError("the arm came off")
        sum(range(20_000))
        return ({{"agentview_image": np.zeros(({size}, {size}, 3))}},)

def make(name, **options):
    assert (name, options["control_freq"]) == ("Lift", 20)
    return Env()
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Returns what installs a robosuite that makes so many steps, with images of a size."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("PYTHONNOUSERSITE", "1")

    def install(left: int = 1_000_000, size: int = 16) -> None:
        (tmp_path / "robosuite.py").write_text(ROBOSUITE.format(left=left, size=size))

    return install


@pytest.mark.parametrize("sees", ["state", "images"])
def test_a_step_of_another_project_is_compared_to_ours(installed, sees):
    installed()
    found = Peers(steps=2, turns=1, size=16).step("robosuite", sees)
    assert found.name.startswith("a step with ") and found.name.endswith("robosuite / ours")
    assert found.ours_s > 0 < found.baseline_s
    assert found.ratio == pytest.approx(found.baseline_s / found.ours_s)


def test_the_peers_time_is_that_of_its_own_process(installed):
    installed()
    with Peer(sys.executable, "robosuite", "state", 16) as peer:
        peer.step(20)
        first = peer.cpu_s
        peer.step(20)
    assert 0 < first < peer.cpu_s


def test_a_package_that_is_absent_is_named_with_the_key_to_use(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "mani_skill.py").write_text("raise ImportError('no mani_skill here')")
    with pytest.raises(MissingExtraError, match=r"no mani_skill here.*maniskill=<folder>/bin/python"):
        Peers().step("maniskill", "state")
    with pytest.raises(MissingExtraError, match="robosuite=/no/python cannot be run: No such file"):
        Peers(robosuite="/no/python").step("robosuite", "state")


def test_images_of_another_size_are_refused(installed):
    installed(size=8)
    with pytest.raises(MissingExtraError, match=r"image is \(8, 8, 3\)"):
        Peer(sys.executable, "robosuite", "images", 16)


def test_an_environment_that_fails_is_quoted(installed):
    installed(left=5)
    with (
        pytest.raises(SimulatorError, match="the arm came off"),
        Peer(sys.executable, "robosuite", "state", 16) as peer,
    ):
        peer.step(100)
