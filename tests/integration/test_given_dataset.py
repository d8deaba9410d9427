"""``train dataset=``: datasets of LeRobot's tools and of other robots are trained on as they are."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file

from benchmark.results import read_result
from policies.checkpoint import WEIGHTS, learned_tasks, resolve, seen_cameras
from roboverse_learn import cli
from roboverse_learn.commands.run_folder import read_config, read_facts
from roboverse_learn.data import DatasetInfo
from roboverse_learn.data.dataset.raw import dataset_hash
from roboverse_learn.data.dataset.schema import COLLECTION_PATH
from tests.integration.main_run import TINY, MainRun
from tests.integration.test_bad_input import snapshot

pytestmark = pytest.mark.slow

WORDS = [word for word in TINY if word.split("=")[0] not in ("image_size", "cameras", "num_demos")]


def opened(root: Path) -> Any:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset("local/given", root=root, video_backend="pyav")


def cleaned(main_run: MainRun, root: Path) -> None:
    from lerobot.datasets.dataset_tools import delete_episodes

    delete_episodes(opened(main_run.dataset), [1], output_dir=root, repo_id="local/given")


def merged(main_run: MainRun, root: Path) -> None:
    from lerobot.datasets.dataset_tools import merge_datasets

    cleaned(main_run, root.with_name("part"))
    parts = [opened(main_run.dataset), opened(root.with_name("part"))]
    merge_datasets(parts, output_repo_id="local/given", output_dir=root)


def split(main_run: MainRun, root: Path) -> None:
    from lerobot.datasets.dataset_tools import split_dataset

    parts = split_dataset(opened(main_run.dataset), {"rest": [0], root.name: [1, 2, 3]}, root.parent)
    assert Path(parts[root.name].root) == root


def of_another_robot(root: Path, use_videos: bool = True, brightest: int = 255) -> Path:
    """A dataset of LeRobot's recorder: six named motors and a camera, whose images are not square."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    motors = {"dtype": "float32", "shape": (6,), "names": [f"motor{i}.pos" for i in range(6)]}
    image = {
        "dtype": "video" if use_videos else "image",
        "shape": (48, 64, 3),
        "names": ["height", "width", "channels"],
    }
    features = {"observation.state": motors, "action": motors, "observation.images.top": image}
    dataset = LeRobotDataset.create(
        "local/given", fps=30, features=features, root=root, use_videos=use_videos
    )
    rng, pixels = np.random.default_rng(0), np.random.default_rng(1)
    for length in (9, 12):
        for _ in range(length):
            dataset.add_frame({
                "observation.state": rng.normal(size=6).astype(np.float32),
                "action": rng.normal(size=6).astype(np.float32),
                "observation.images.top": pixels.integers(0, brightest, (48, 64, 3), dtype=np.uint8),
                "task": "fold the towel",
            })  # fmt: skip
        dataset.save_episode()
    dataset.finalize()
    return root


def folders(tmp_path: Path) -> list[str]:
    return [f"{key}={tmp_path / key}" for key in ("runs_dir", "results_dir", "datasets_dir")]


@pytest.mark.parametrize(
    ("edited", "episodes", "robots"),
    [(cleaned, 3, ["franka"]), (merged, 7, ["", "franka"]), (split, 3, ["franka"])],
)
def test_a_dataset_that_lerobot_edited_is_trained_on_and_its_policy_evaluated(
    main_run: MainRun,
    tmp_path: Path,
    edited: Callable[[MainRun, Path], None],
    episodes: int,
    robots: list[str],
) -> None:
    root = tmp_path / "edited"
    edited(main_run, root)
    before = snapshot(root)
    assert cli.main(["train", *WORDS, f"dataset={root}", *folders(tmp_path)]) == 0
    (run,) = (tmp_path / "runs_dir/edited/act").iterdir()
    facts = read_facts(run, "collect")
    assert (facts["num_episodes"], facts["level"], facts["folder"]) == (episodes, None, str(root))
    assert facts["robots"] == robots
    # Cameras and image size are the dataset's.
    assert read_config(run).env.cameras == ("front",) and read_config(run).env.image_size == 32
    result = read_result(tmp_path / "results_dir/v2/PickCube/act" / f"{run.name}.json")
    assert (result.train_level, result.demonstrations) == (None, episodes)
    assert result.dataset_hash == facts["dataset_hash"]
    assert snapshot(root) == before and not (tmp_path / "datasets_dir").exists()


@pytest.mark.parametrize("use_videos", [True, False])
def test_a_dataset_of_another_robot_is_trained_on_and_evaluation_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], use_videos: bool
) -> None:
    root = of_another_robot(tmp_path / "towels", use_videos)
    assert cli.main(["train", *WORDS, f"dataset={root}", *folders(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Read 2 demonstrations, 21 frames, of" in said and "Trained 12 steps" in said
    assert "The policy is not evaluated, for it cannot act in PickCube: the images of the dataset are" in said
    (run,) = (tmp_path / "runs_dir/towels/act").iterdir()
    checkpoint = resolve(run)
    assert set(seen_cameras(checkpoint)) == {"top"} and learned_tasks(checkpoint) == ()
    assert not (tmp_path / "results_dir").exists()


@pytest.mark.parametrize("use_videos", [True, False])
def test_other_images_are_another_dataset(tmp_path: Path, use_videos: bool) -> None:
    first, same, darker = (
        of_another_robot(tmp_path / name, use_videos, brightest)
        for name, brightest in (("first", 255), ("same", 255), ("darker", 100))
    )
    assert dataset_hash(first) == dataset_hash(same) != dataset_hash(darker)
    numbers = [DatasetInfo.open(root).read_columns() for root in (first, darker)]
    assert all(np.array_equal(numbers[0][key], numbers[1][key]) for key in numbers[0])


def test_another_dataset_is_another_run(main_run: MainRun, tmp_path: Path) -> None:
    root = of_another_robot(tmp_path / "a" / "towels")
    other = shutil.copytree(root, tmp_path / "b" / "towels")
    words = ["train", *WORDS, "train.steps=2", *folders(tmp_path)]
    for same in (root, other):
        assert cli.main([*words, f"dataset={same}"]) == 0
    assert len(list((tmp_path / "runs_dir/towels/act").iterdir())) == 1
    path = next((other / "data").rglob("*.parquet"))
    double_actions(path)
    assert cli.main([*words, f"dataset={other}"]) == 0
    assert len(list((tmp_path / "runs_dir/towels/act").iterdir())) == 2


def double_actions(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    column = table.schema.get_field_index("action")
    doubled = pa.array(
        [[2 * x for x in row] for row in table["action"].to_pylist()], table.schema.types[column]
    )
    pq.write_table(table.set_column(column, table.schema.field(column), doubled), path)


def test_a_dataset_of_ours_is_trained_on_and_never_collected_into(
    main_run: MainRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = shutil.copytree(main_run.dataset, tmp_path / "demos")
    before = snapshot(root)
    words = ["train", *TINY, f"dataset={root}", *folders(tmp_path)]
    assert cli.main([*words, "num_demos=5", "train.steps=2"]) == 0
    (run,) = (tmp_path / "runs_dir/PickCube/act").iterdir()
    facts = read_facts(run, "collect")
    assert (facts["num_episodes"], facts["level"], facts["robots"]) == (4, 0, [""])
    assert cli.main([*words, "level=3"]) == 2
    assert "was begun with level=0; now given: level=3" in capsys.readouterr().err
    recorded = json.loads((root / COLLECTION_PATH).read_text())
    changing = recorded | {"settings": recorded["settings"] | {"steps_per_look": 1}}
    (root / COLLECTION_PATH).write_text(json.dumps(changing))
    assert cli.main([*words, "steps_per_look=2"]) == 2
    assert "was begun with steps_per_look=1; now given: steps_per_look=2" in capsys.readouterr().err
    # Without the record of its collection, each episode still says its task and level.
    (root / COLLECTION_PATH).unlink()
    assert cli.main([*words, "level=3", "train.steps=2"]) == 0
    (run,) = (tmp_path / "runs_dir/demos/act").iterdir()
    assert read_facts(run, "collect")["level"] == 0
    assert cli.main([*words, "task=StackCube"]) == 2
    assert "is of PickCube, and the run is of StackCube. Add task=PickCube." in capsys.readouterr().err
    assert DatasetInfo.open(root).num_episodes == 4
    assert {name: content for name, content in before.items() if name != COLLECTION_PATH} == snapshot(root)


def test_a_run_does_not_go_on_with_other_demonstrations(
    main_run: MainRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = shutil.copytree(main_run.dataset, tmp_path / "demos")
    words = ["train", *TINY, f"dataset={root}", *folders(tmp_path), "train.steps=2"]
    assert cli.main(words) == 0
    double_actions(next((root / "data").rglob("*.parquet")))
    assert cli.main(words) == 2
    said = capsys.readouterr().err
    assert "was started with the demonstrations" in said and "Add resume=false" in said


def test_training_goes_on_from_the_weights_of_another_run(main_run: MainRun, tmp_path: Path) -> None:
    words = [*TINY, f"dataset={main_run.dataset}", *folders(tmp_path), "levels=[0]"]
    words += ["train.steps=1", "train.lr=1e-12", "train.lr_backbone=1e-12", "train.lr_muon=1e-12"]
    assert cli.main(["train", *words, f"train.resume_from={main_run.run}", f"run={tmp_path / 'run'}"]) == 0
    before, after = (load_file(resolve(each) / WEIGHTS) for each in (main_run.checkpoint, tmp_path / "run"))
    assert before.keys() == after.keys()
    for key, values in before.items():
        np.testing.assert_allclose(after[key], values, atol=1e-6, err_msg=key)
