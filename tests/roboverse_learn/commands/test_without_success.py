"""A scene in which no demonstration succeeds: the collection ends, and says what to change."""

import json
from pathlib import Path

import pytest

from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.config.compose import compose
from roboverse_learn.data.collection import schedule
from roboverse_learn.data.sources import SOURCES


@pytest.mark.slow
def test_what_makes_a_scene_impossible_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedule, "GIVE_UP_AFTER", 2)
    words = ["image_size=32", "num_workers=1", "collect.num_envs=1", f"datasets_dir={tmp_path}"]
    config = compose("collect", [*words, "level=1", "scenario.objects.cube.geoms.0.mass_kg=500"])
    with pytest.raises(schedule.TooFewSuccessesError) as raised:
        collect_dataset(config)
    # Three rounds of one environment are more than two episodes.
    assert str(raised.value) == (
        "None of the 3 episodes that were tried succeeded. The same command tries others. Leave out, or make "
        "easier, what differs from the task's own scene: level, scenario.objects.cube.geoms.0.mass_kg."
    )
    record = json.loads((dataset_folder(config) / schedule.COLLECTION_PATH).read_text())
    assert len(record["failed"]) == 3


@pytest.mark.parametrize(
    ("words", "help_"),
    [
        ([], "Measure the expert with: python -m envs.experts.check task=PickCube"),
        (
            ["source=policy", "checkpoint=runs/x"],
            "The policy of 'runs/x' needs more training, or learned in ",
        ),
        (["source=robosuite", "path=a.h5"], "Try the other way to replay: replay=states or replay=controls."),
        (["only=camera", "simulator=newton"], "the task's own scene: only, simulator."),
    ],
)
def test_every_source_has_its_own_help(words: list[str], help_: str) -> None:
    config = compose("collect", words)
    assert help_ in SOURCES.get(config.source)(config).advice()
