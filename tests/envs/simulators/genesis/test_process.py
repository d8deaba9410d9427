"""Genesis in a process: memory of closed scenes, and restarts."""

import gc

import mujoco
import pytest

pytest.importorskip("genesis", reason="Genesis is not installed: see docs/simulator_costs.md")

import genesis

from envs.core.errors import SimulatorError
from envs.mjcf.link_tree import describe
from envs.scenario import GeomCfg, ObjectCfg, ScenarioCfg
from envs.simulators.genesis import process
from envs.simulators.genesis.batch import Batch
from envs.simulators.genesis.settings import GenesisSettings
from tests.envs.simulators.reaching import launched

pytestmark = pytest.mark.slow

BALL = ObjectCfg(
    name="ball", geoms=(GeomCfg(shape="sphere", size=(0.05,), mass_kg=0.1),), pos=(0.0, 0.0, 0.2)
)
SCENE = ScenarioCfg(objects=(BALL,), room=None)


def arrays():
    from quadrants.lang.impl import get_runtime

    gc.collect()
    return len(get_runtime().ndarrays)


def test_the_arrays_of_a_closed_scene_are_freed():
    counts = []
    for _ in range(2):
        with launched("genesis", SCENE) as handler:
            handler.step(3)
        del handler
        counts.append(arrays())
    assert counts[0] == counts[1]


def test_it_restarts_after_many_scenes_but_not_while_one_is_open(monkeypatch):
    monkeypatch.setattr(process, "SCENES_KEPT", 0)
    monkeypatch.setattr(process._PROCESS, "is_ours", True)
    started = []
    real = genesis.init
    monkeypatch.setattr(genesis, "init", lambda **options: (started.append(1), real(**options)))
    with launched("genesis", SCENE) as first:
        assert len(started) == 1
        with launched("genesis", SCENE) as second:
            second.step(1)
        first.step(1)
        assert len(started) == 1
    with launched("genesis", SCENE) as third:
        third.step(3)
    assert len(started) == 2
    assert not process._PROCESS.open


def test_restart_clears_cached_kernel_arguments(monkeypatch):
    monkeypatch.setattr(process, "SCENES_KEPT", 0)
    monkeypatch.setattr(process._PROCESS, "is_ours", True)
    known = []
    for _ in range(3):
        with launched("genesis", SCENE) as handler:
            handler.step(3)
        known.append(
            {
                name: sum(len(getattr(kernel, name)) for kernel in process._runtime().kernels)
                for name in process._KINDS
            }
        )
        known[-1]["mapping"] = sum(len(kernel.mapper.mapping) for kernel in process._runtime().kernels)
    assert known[0]["mapping"] > 0
    assert known[1] == known[2]


def test_a_scene_that_is_not_built_is_not_counted_as_open():
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(SimulatorError, match="nothing in this scene that Genesis could simulate"):
        Batch(model, describe(model, "genesis"), GenesisSettings(), 1)
    assert not process._PROCESS.open
