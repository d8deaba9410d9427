"""What a policy looks at, as ``python -m roboverse_learn.commands.inputs`` prints it."""

import pytest

import policies
from benchmark.inputs import Call
from roboverse_learn.commands.dataset_layout import dataset_layout
from roboverse_learn.commands.inputs import main, table
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.config.compose import compose
from roboverse_learn.training.imitation.estimate import plain_stats

WORDS = ("policy=act", "preset=quick", "task=PickCube", "device=cpu", "image_size=32", "cameras=[front]")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Returns a run whose policy was not trained."""
    monkeypatch.chdir(tmp_path)
    config = compose("train", WORDS)
    features, _, _ = dataset_layout(config)
    policy = policies.create("act", features, plain_stats(features), config.policy)
    with RunFolder.open(config, ["roboverse", "train"]) as opened:
        policy.save(opened.folder / "checkpoints/last/pretrained_model")
        return opened.folder


def test_a_run_shows_the_share_of_each_input_call_by_call(run, caplog):
    caplog.set_level("INFO")
    assert main([f"checkpoint={run}", "episodes=4", "calls=2", "device=cpu"]) == 0
    heading, *rows = [line.split("  ") for line in caplog.messages[-1].splitlines()]
    heading, *rows = [[cell.strip() for cell in row if cell.strip()] for row in (heading, *rows)]
    assert heading == ["input of another episode", "step 0", "step 10"]
    shares = {row[0]: row[1:] for row in rows}
    assert list(shares) == ["state", "images.front", "instruction", "all but the instruction"]
    assert shares["instruction"] == ["0 %", "0 %"], "ACT does not read"
    assert all(int(cell.removesuffix(" %")) > 0 for cell in shares["images.front"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "Name what was trained: checkpoint=runs/<run>"),
        (["checkpoint=runs", "calls=0"], "calls must be 1 or more, given 0"),
        (["checkpoint=runs", "episode=8"], "episodes"),
    ],
)
def test_a_wrong_setting_is_one_sentence(words, said, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error


def test_too_few_episodes_are_named(run, capsys):
    assert main([f"checkpoint={run}", "episodes=3", "device=cpu"]) == 2
    assert "episodes=3 are too few" in capsys.readouterr().err


def test_what_nothing_moves_has_no_share():
    assert table([Call(step=0, moved={"state": 0.0}, moved_by_all=0.0)]).splitlines()[1].split() == [
        "state",
        "-",
    ]
