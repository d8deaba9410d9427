"""How long collecting and evaluating will take: one demonstration is timed, and the rest is arithmetic."""

import logging
from pathlib import Path

import pytest

from roboverse_learn import train as command
from roboverse_learn.commands import run_estimate
from roboverse_learn.commands.run_estimate import DemonstrationTime, beside_training, time_demonstration
from roboverse_learn.config.compose import compose
from roboverse_learn.data.sources.changing_looks import ChangingLooks
from roboverse_learn.training.learners import Learner

TASK = ("policy=act", "task=PickCube", "policy.n_action_steps=10")
HOUR = 3600.0


@pytest.fixture
def timed(monkeypatch, tmp_path) -> None:
    """Of two cores, one takes a second for a demonstration of 50 steps, a tenth of it without images.

    The policy acts for ten steps in 30 ms.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_estimate, "num_cores", lambda: 2)
    monkeypatch.setattr(
        run_estimate,
        "time_demonstration",
        lambda spec, steps_per_look: DemonstrationTime(
            seconds=1.0, without_images_s=0.1, steps=50, collected_s=3.0 if steps_per_look else 1.0
        ),
    )
    monkeypatch.setattr(run_estimate, "time_policy", lambda config: (0.03, 10))


def test_demonstrations_and_test_episodes_share_the_cores(timed) -> None:
    words = [*TASK, "num_demos=300", "level=0", "evaluate.levels=[0,3]", "evaluate.alone=[camera]"]
    config = compose("train", [*words, "evaluate.episodes=40", "evaluate.splits=[test]"])
    others = beside_training(config)
    assert others is not None
    assert others.collect_s == pytest.approx(300 * 1.0 / 2)
    # A step costs 0.1 s / 50 and a tenth of an image's 0.9 s / 50, shared by two cores, and a tenth of 30 ms.
    # Level 3 and moved cameras, which training does not know, take the limit of 100 steps.
    step_s = (0.1 + 0.9 / 10) / 50 / 2 + 0.03 / 10
    assert others.evaluate_s == pytest.approx(40 * (50 + 100 + 100) * step_s)


def test_looks_that_change_count_for_collecting_alone(timed) -> None:
    words = (*TASK, "num_demos=300", "level=3")
    kept, changing = (
        beside_training(compose("train", [*words, *more])) for more in ([], ["steps_per_look=4"])
    )
    assert kept is not None and changing is not None
    assert changing.collect_s == 3 * kept.collect_s
    assert changing.evaluate_s == kept.evaluate_s


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["act", "diffusion"])
def test_an_untrained_policy_is_timed(policy: str) -> None:
    words = [f"policy={policy}", "preset=quick", "task=PickCube", "image_size=32", "cameras=[front]"]
    config = compose("train", words)
    seconds, steps = run_estimate.time_policy(config)
    assert 0 < seconds < 60
    assert steps == config.policy.n_action_steps


def test_demonstrations_that_are_there_are_not_counted(timed, monkeypatch) -> None:
    config = compose("train", [*TASK, "num_demos=300"])
    monkeypatch.setattr(run_estimate, "num_collected", lambda config: 300)
    others = beside_training(config)
    assert others is not None
    assert others.collect_s == 0


@pytest.mark.parametrize(
    "words",
    [
        ("source=rerender", "from=datasets/other"),
        ("dataset=datasets/mine",),
        ("simulator=mujoco_warp",),
    ],
)
def test_what_one_demonstration_says_nothing_about_is_not_estimated(timed, words: tuple[str, ...]) -> None:
    assert beside_training(compose("train", [*TASK, *words])) is None


def test_a_quick_run_says_at_its_start_how_long_each_stage_will_take(timed, caplog) -> None:
    class Timed(Learner):
        def estimate_s(self) -> float:
            return 0.2 * HOUR

    caplog.set_level(logging.INFO)
    words = (*TASK, "preset=quick", "num_demos=720", "evaluate.levels=[0]", "evaluate.splits=[test]")
    command.refuse_long_run(Timed(compose("train", words), "cpu"))
    assert caplog.messages[-1] == (
        "This run will take about 18 minutes: "
        "6 minutes to collect, 12 minutes to train, 1 minute to evaluate."
    )


@pytest.mark.slow
def test_an_estimate_writes_nothing(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    config = compose("train", [*TASK, "preset=quick", "image_size=32", "cameras=[front]"])
    demonstration = time_demonstration(config.env)
    assert 0 < demonstration.without_images_s <= demonstration.seconds
    assert 10 < demonstration.steps <= 100
    assert demonstration.collected_s == demonstration.seconds
    changes: list[int] = []
    monkeypatch.setattr(ChangingLooks, "__call__", lambda self, episode: changes.append(episode.length))
    changing = time_demonstration(config.env, 1)
    assert changing.steps == demonstration.steps
    assert changes == list(range(changing.steps + 1))  # in one of its three passes
    assert not list(tmp_path.iterdir())
