"""How the train command finds what trains a policy."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import policies
from envs.core.errors import ConfigError, PolicyError, UnknownNameError
from roboverse_learn import train as command
from roboverse_learn.config.compose import compose
from roboverse_learn.training.learners import LEARNERS, AgentLearner, Learner, learner_of
from roboverse_learn.training.reporter import Reporter


class Recorder(Learner):
    """Returns what it is given."""

    def learn(self, run_dir, dataset, seed, reporter):
        seen = {"config": self.config, "run_dir": run_dir, "dataset": dataset, "seed": seed}
        return SimpleNamespace(reporter=reporter, **seen)


class Agent(AgentLearner):
    """A learner that uses one process alone."""


@pytest.fixture
def act_learner(monkeypatch):
    """Lets another learner, of a package of its own, train ACT."""

    def use(learner: str) -> None:
        entry = policies.POLICIES.entry("act")
        changed = replace(entry, target=replace(entry.target, learner=learner))
        monkeypatch.setitem(policies.POLICIES._entries, "act", changed)

    return use


def test_every_trainable_policy_has_a_learner():
    for name in policies.names():
        learner = LEARNERS.get(policies.learner(name))
        assert issubclass(learner, AgentLearner) == (policies.learns_from(name) == "env")


def test_learner_of_another_package_receives_the_run(act_learner, tmp_path: Path):
    act_learner(f"{__name__}:Recorder")
    config = compose("train", ["seed=3"])
    result = command._train(config, tmp_path, "demos", "cpu")
    assert (result.run_dir, result.config, result.dataset) == (tmp_path, config, "demos")
    assert isinstance(result.reporter, Reporter)
    assert result.seed == command._train(config, tmp_path, "demos", "cpu").seed
    assert result.seed != command._train(compose("train", ["seed=4"]), tmp_path, "demos", "cpu").seed


def test_unknown_learner_is_an_error(act_learner):
    act_learner("imitate")
    with pytest.raises(UnknownNameError, match=r"Unknown learner 'imitate'. Did you mean 'imitation'"):
        learner_of(compose("train", []), "cpu")


def test_agents_refuse_several_processes(act_learner, monkeypatch: pytest.MonkeyPatch):
    act_learner(f"{__name__}:Agent")
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(ConfigError, match="policy=act learns in one process; start it without `accelerate"):
        learner_of(compose("train", []), "cpu")


def test_a_run_that_goes_on_from_a_checkpoint_of_another_policy_is_refused(tmp_path):
    given = [f"train.resume_from={tmp_path}"]
    with pytest.raises(ConfigError, match=r"policy=ppo takes no train\.resume_from"):
        learner_of(compose("train", ["policy=ppo", "task=control/cartpole", *given]), "cpu")
    learner = learner_of(compose("train", given), "cpu")
    with pytest.raises(PolicyError, match=r"has no config\.json"):
        learner.check()
    (tmp_path / "config.json").write_text('{"type": "diffusion"}')
    with pytest.raises(ConfigError, match=r"is of policy 'diffusion', and the run trains 'act'"):
        learner.check()


def test_images_of_a_camera_that_is_not_seen_are_not_swapped():
    words = ["train.augment.swap=0.5", "cameras=[front,wrist]"]
    learner_of(compose("train", [*words, "train.augment.swap_camera=wrist"]), "cpu").check()
    with pytest.raises(
        UnknownNameError, match=r"train\.augment\.swap_camera 'frnt'\. Did you mean 'front'\?"
    ):
        learner_of(compose("train", [*words, "train.augment.swap_camera=frnt"]), "cpu").check()


def test_a_run_of_one_task_mixes_none():
    with pytest.raises(
        ConfigError, match=r"train\.mixing=0\.5 weighs several tasks, and the run is of PickCube alone"
    ):
        learner_of(compose("train", ["policy=mtact", "train.mixing=0.5"]), "cpu").check()
    with pytest.raises(ConfigError, match=r"train\.mixing must be from 0 to 1, given 1\.5"):
        compose("train", ["policy=mtact", "train.mixing=1.5"])


@pytest.mark.parametrize("policy", ["ppo", "tdmpc2", "fasttd3"])
def test_an_agent_mixes_no_demonstrations(policy):
    with pytest.raises(ConfigError, match=rf"policy={policy} takes no train\.mixing, which is for demonstr"):
        learner_of(compose("train", [f"policy={policy}", "task=control/cartpole", "train.mixing=0.5"]), "cpu")


@pytest.mark.parametrize("mixing", ["0", "0.5"])
def test_a_batch_smaller_than_its_tasks_is_refused_before_demonstrations_are_collected(mixing, monkeypatch):
    words = ["policy=mtact", "task=[PickCube,StackCube,CloseBox]", f"train.mixing={mixing}"]
    with pytest.raises(ConfigError, match=r"batch_size=2 must .* one frame of each of 3 tasks"):
        learner_of(compose("train", [*words, "train.batch_size=2"]), "cpu").check()
    learner_of(compose("train", [*words, "train.batch_size=3"]), "cpu").check()
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(ConfigError, match=r"batch_size=3 must be a multiple of 2 processes"):
        learner_of(compose("train", [*words, "train.batch_size=3"]), "cpu").check()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["train.steps=50"], "train.steps=50 are all warm-up (train.warmup_steps=100)"),
        (["train.steps=100"], "train.steps=100 are all warm-up"),
        (
            ["policy=lerobot", "type=vqbet", "train.steps=50", "train.warmup_steps=50"],  # of LeRobot's rate
            "while the learning rate still rises to its peak, and",
        ),
        (["train.steps=101"], ""),
        (["train.steps=50", "train.warmup_steps=5"], ""),
        (["train.steps=1", "train.warmup_steps=0"], ""),
    ],
)
def test_a_run_that_is_all_warm_up_says_so_at_its_start(words, said, caplog, monkeypatch):
    def stop(learner):
        raise ConfigError("far enough")

    monkeypatch.setattr(command, "refuse_long_run", stop)
    with pytest.raises(ConfigError, match="far enough"):
        command.train(compose("train", ["device=cpu", "preset=quick", *words]))
    assert caplog.text.count("all warm-up") == bool(said) and said in caplog.text


@pytest.mark.parametrize(("steps", "warn"), [(999, True), (1000, False)])
def test_an_agent_whose_steps_end_before_its_first_update_says_so(steps, warn, caplog, tmp_path, monkeypatch):
    learner = Agent(compose("train", ["policy=tdmpc2", f"train.steps={steps}"]), "cpu")
    monkeypatch.setattr(learner, "open_env", lambda seed: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(learner, "make_agent", lambda env, seed: SimpleNamespace(first_steps=1000))
    monkeypatch.setattr(learner, "run", lambda *_: None)
    learner.learn(tmp_path, None, 0, Reporter())
    assert ("train.steps=999 end before the first update, which comes after 1000" in caplog.text) == warn
