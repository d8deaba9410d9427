"""The speed of agents that learn by reward, on a CPU: all four parts are measured."""

import json
import sys

import pytest

from envs.core.errors import MissingExtraError
from roboverse_learn.speed import agents, replay
from roboverse_learn.speed.agents import GPU, Scale, measure

TINY = Scale(model_size=1, tdmpc2_batch=2, plan_envs=1, fasttd3_batch=8, fasttd3_dim=16, updates=1, turns=1)


def test_a_gpu_gets_the_published_sizes():
    assert (GPU.model_size, GPU.tdmpc2_batch, GPU.fasttd3_batch, GPU.fasttd3_dim) == (5, 256, 32_768, 1024)


def test_updates_and_planning_are_measured():
    parts = ("tdmpc2_update", "tdmpc2_planning", "fasttd3_update")
    update, planning, fasttd3 = measure(TINY, "cpu", compiled=False, parts=parts)
    assert update.name == "TD-MPC2, update, size 1, batch 2 on cpu, plain torch / ours"
    assert planning.name.startswith("TD-MPC2, planning for 1 envs")
    assert fasttd3.name.startswith("FastTD3, update, batch 8")
    assert all(each.ours_s > 0 < each.baseline_s for each in (update, planning, fasttd3))


def test_the_updates_are_those_of_training():
    terms = agents.tdmpc2_update(TINY, "cpu")()
    assert {"loss", "consistency_loss", "prior_loss"} <= terms.keys()
    update = agents.fasttd3_update(TINY, "cpu")
    assert float(update()["loss"]) != float(update()["loss"])
    assert agents.tdmpc2_planning(TINY, "cpu")().shape == (1, 19)


def test_the_program_measures_the_parts_that_it_is_asked_for(tmp_path, monkeypatch, caplog, capsys):
    monkeypatch.setattr(agents, "CPU", TINY)
    out = tmp_path / "not yet there" / "agents.json"
    words = ["parts=[fasttd3_update]", "device=cpu", f"out={out}"]
    with caplog.at_level("INFO"):
        assert agents.main(words) == 0
    (row,) = json.loads(out.read_text())["rows"]
    assert row["name"].startswith("FastTD3, update") and row["ratio"] > 0
    assert agents.main(["parts=[tdmpc_update]"]) == 2
    assert "Unknown part of this benchmark 'tdmpc_update'. Did you" in capsys.readouterr().err


def test_the_replay_is_measured_against_torchrls_by_batches_of_one_size(monkeypatch):
    monkeypatch.setattr(replay, "STEPS", 4000)
    ours, theirs = (make(3, 2, "cpu")() for make in (replay.our_sequences, replay.torchrl_slices))
    assert ours.actions.numel() == theirs["action"].numel() == 256 * 4 * 2
    episodes = theirs["episode"].view(256, 4)
    assert (episodes == episodes[:, :1]).all()  # a slice is of one episode
    (found,) = measure(TINY, "cpu", compiled=False, parts=("replay",))
    assert found.name == "Replay, 256 sequences of 4 on cpu, TorchRL's SliceSampler / ours"
    assert found.ratio > 0 and found.goal == "reported"


def test_a_missing_torchrl_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "torchrl.data", None)
    with pytest.raises(
        MissingExtraError, match=r"parts=\[replay\] compares with TorchRL.*roboverse-learn\[torchrl\]"
    ):
        replay.torchrl_slices(3, 2, "cpu")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")  # of the compiler
def test_compiled_on_a_cpu_it_runs_too():
    update, fasttd3 = measure(TINY, "cpu", compiled=True, parts=("tdmpc2_update", "fasttd3_update"))
    assert update.ratio > 0 < fasttd3.ratio
