"""A collection takes no more processes and environments than the machine holds, and says so."""

import pytest

from roboverse_learn.config.compose import compose
from roboverse_learn.data.collection import limits


@pytest.fixture
def machine(monkeypatch):
    """Makes a machine of so many cores and bytes of free memory."""

    def make(cores: int, free: int) -> None:
        monkeypatch.setattr(limits, "num_cores", lambda: cores)
        monkeypatch.setattr(limits, "free_memory_bytes", lambda: free)

    return make


def fitted(*words: str):
    collect = limits.within_machine(compose("collect", ["task=PickCube", *words])).collect
    return collect.num_workers, collect.num_envs


def test_a_million_workers_become_one_per_core(machine, caplog):
    machine(4, 64 << 30)
    assert fitted("collect.num_workers=1000000", "collect.num_envs=2") == (4, 2)
    assert (
        "num_workers=1000000 with num_envs=2 is more than this machine holds (4 cores, 68.7 GB" in caplog.text
    )
    assert "num_workers=4 with num_envs=2 is used" in caplog.text


def test_workers_share_the_free_memory(machine, caplog):
    machine(16, 3 * limits.WORKER_BYTES + 1)
    workers, envs = fitted("collect.num_workers=16", "collect.num_envs=1")
    assert (workers, envs) == (3, 1)
    assert "num_workers=3 with num_envs=1 is used" in caplog.text


def test_a_thousand_million_environments_become_those_that_fit(machine, caplog):
    machine(2, 8 << 30)
    workers, envs = fitted("collect.num_workers=2", "collect.num_envs=1000000000")
    assert workers == 2
    assert 1 < envs < 2000
    assert f"num_envs={envs} is used" in caplog.text


@pytest.mark.parametrize(("simulator", "workers"), [("mujoco", 6), ("mujoco_warp", 1)])
def test_the_default_is_a_process_per_core_unless_one_steps_all(machine, caplog, simulator, workers):
    machine(6, 64 << 30)
    assert fitted(f"simulator={simulator}", "collect.num_envs=3") == (workers, 3)
    assert not caplog.records, "nothing is lowered, so nothing is said"


def test_a_machine_without_free_memory_still_gets_one(machine):
    machine(8, 0)
    assert fitted("collect.num_workers=8", "collect.num_envs=5") == (1, 1)


@pytest.mark.parametrize(
    ("simulator", "cores", "workers", "demos", "encoders"),
    [("mujoco_warp", 32, 1, 1000, 16), ("mujoco_warp", 12, 1, 1000, 6), ("mujoco_warp", 32, 1, 50, 3),
     ("mujoco_warp", 32, 1, 10, 0), ("mujoco_warp", 2, 1, 1000, 0), ("mujoco", 32, 1, 1000, 0),
     ("mujoco_warp", 32, 4, 1000, 0)],
)  # fmt: skip
def test_processes_encode_for_one_that_steps_all_environments(
    machine, simulator, cores, workers, demos, encoders
):  # fmt: skip
    machine(cores, 64 << 30)
    words = [f"simulator={simulator}", f"collect.num_workers={workers}", f"num_demos={demos}"]
    config = compose("collect", ["task=PickCube", *words])
    assert limits.num_encoders(config) == encoders
