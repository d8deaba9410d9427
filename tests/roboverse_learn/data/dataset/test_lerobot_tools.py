"""LeRobot's own tools on a dataset of ours: its commands, its readers, without noise."""

import json
import os
import re
import shlex
import shutil
import subprocess
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from roboverse_learn import cli
from roboverse_learn.data import DatasetInfo
from tests import imported_process

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[4] / "docs/concepts/dataset.md"


def _run(*words) -> str:
    """Returns what a program prints, errors too."""
    done = imported_process.run(*words)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def _edit(root, operation, *words, new=None) -> str:
    """Runs an operation of ``lerobot-edit-dataset`` on a folder; returns what is printed."""
    given = ["--repo_id=local/test", f"--root={root}", f"--operation.type={operation}"]
    if new is not None:
        given += ["--new_repo_id=local/edited", f"--new_root={new}"]
    return _run(imported_process.installed("lerobot-edit-dataset"), *given, *words)


def _is_whole(root) -> bool:
    """Whether our own command reads a dataset and finds all frames in its videos."""
    return cli.main(["dataset", "info", str(root)]) == 0


def _columns(stock) -> np.ndarray:
    """Returns the states of all frames, as LeRobot's reader gives them."""
    return np.stack(stock.hf_dataset["observation.state"])


def test_lerobot_info_runs_and_prints_no_traceback():
    printed = _run(imported_process.installed("lerobot-info"))
    assert "LeRobot version" in printed
    assert "Traceback" not in printed, "torchcodec is installed and finds no FFmpeg; see overrides.txt"


def test_lerobots_reader_decodes_by_default_without_a_traceback(written):
    code = (
        "import sys; from lerobot.datasets.lerobot_dataset import LeRobotDataset\n"
        "frame = LeRobotDataset('local/test', root=sys.argv[1])[3]\n"
        "print('image', tuple(frame['observation.images.front'].shape))"
    )
    printed = _run(code, str(written))
    assert "image (3, 32, 32)" in printed
    assert "Traceback" not in printed and len(printed.splitlines()) <= 2  # LeRobot names its decoder


def test_the_edit_command_describes_a_dataset(written):
    info = DatasetInfo.open(written)
    printed = _edit(written, "info", "--operation.show_features=true")
    assert f"Total episode: {info.num_episodes} " in printed and "Total task: 2 " in printed
    assert f"Total frame(Actual Count): {info.num_frames}({info.num_frames})" in printed
    assert f"FPS: {info.fps}" in printed and '"observation.images.front": {' in printed


def test_the_edit_command_deletes_episodes(written, tmp_path, open_with_lerobot):
    _edit(written, "delete_episodes", "--operation.episode_indices=[0,3]", new=tmp_path / "less")
    before, after = open_with_lerobot(written), open_with_lerobot(tmp_path / "less")
    stays = ~np.isin(np.array(before.hf_dataset["episode_index"]), (0, 3))
    np.testing.assert_array_equal(_columns(after), _columns(before)[stays])
    for new, old in enumerate(np.flatnonzero(stays)):
        image = before[int(old)]["observation.images.front"]
        assert torch.equal(after[new]["observation.images.front"], image)  # of the right video
    assert after.num_episodes == 4 and _is_whole(tmp_path / "less")


def test_the_edit_command_splits_a_dataset_and_merges_the_parts_again(written, tmp_path, open_with_lerobot):
    parts = {"first": [0, 1, 2, 3], "last": [4, 5]}
    splits = f"--operation.splits={json.dumps(parts)}"
    command = imported_process.installed("lerobot-edit-dataset")
    _run(command, "--repo_id=local/test", f"--root={written}", f"--new_root={tmp_path}",
         "--operation.type=split", splits)  # fmt: skip
    roots = [tmp_path / name for name in parts]
    assert [DatasetInfo.open(root).num_episodes for root in roots] == [4, 2]
    assert all(map(_is_whole, roots))
    _run(command, "--new_repo_id=local/all", f"--new_root={tmp_path / 'all'}", "--operation.type=merge",
         "--operation.repo_ids=['local/first','local/last']",
         f"--operation.roots={[str(root) for root in roots]}")  # fmt: skip
    before, after = open_with_lerobot(written), open_with_lerobot(tmp_path / "all")
    np.testing.assert_array_equal(_columns(after), _columns(before))
    assert [frame["task"] for frame in after] == [frame["task"] for frame in before]
    assert _is_whole(tmp_path / "all")


def test_the_edit_command_removes_a_feature(written, tmp_path, open_with_lerobot):
    _edit(written, "remove_feature", "--operation.feature_names=['observation.images.front']",
          new=tmp_path / "blind")  # fmt: skip
    after = open_with_lerobot(tmp_path / "blind")
    assert not after.meta.camera_keys and not list((tmp_path / "blind").rglob("*.mp4"))
    np.testing.assert_array_equal(_columns(after), _columns(open_with_lerobot(written)))


def test_the_edit_command_changes_the_instructions(written, tmp_path, open_with_lerobot):
    root = shutil.copytree(written, tmp_path / "said")  # this operation changes a dataset in place
    _edit(root, "modify_tasks", '--operation.task_replacements={"lift the cube": "raise the cube"}')
    after = open_with_lerobot(root)
    assert {frame["task"] for frame in after} == {"raise the cube", "push the cube"}
    assert set(DatasetInfo.open(root).tasks) == {"raise the cube", "push the cube"} and _is_whole(root)


def test_the_edit_command_finds_the_statistics_that_are_written(written, tmp_path):
    _edit(written, "recompute_stats", new=tmp_path / "again")
    ours, theirs = DatasetInfo.open(written).stats, DatasetInfo.open(tmp_path / "again").stats
    for key in ("observation.state", "action"):
        for name in ("min", "max", "mean", "std"):
            np.testing.assert_allclose(theirs[key][name], ours[key][name], atol=1e-5)


def test_the_edit_command_encodes_the_videos_again(written, tmp_path, open_with_lerobot):
    encoder = ("--operation.rgb_encoder.vcodec=h264", "--operation.rgb_encoder.crf=10")
    _edit(written, "reencode_videos", *encoder, new=tmp_path / "small")
    before, after = open_with_lerobot(written), open_with_lerobot(tmp_path / "small")
    for index in range(len(before)):
        images = [each[index]["observation.images.front"].float() for each in (before, after)]
        assert (images[0] - images[1]).abs().mean() < 8  # of 255
    assert _is_whole(tmp_path / "small")


def test_the_edit_command_leaves_videos_as_they_are_where_it_would_make_some(written, tmp_path):
    words = ["--repo_id=local/test", f"--root={written}", f"--new_root={tmp_path / 'new'}"]
    program = imported_process.installed("lerobot-edit-dataset")
    done = imported_process.run(program, *words, "--operation.type=convert_image_to_video")
    assert done.returncode == 1 and "This operation is for image datasets only" in done.stdout + done.stderr
    assert not (tmp_path / "new").exists() and _is_whole(written)


def test_the_edit_command_has_no_other_operation():
    from lerobot.scripts.lerobot_edit_dataset import OperationConfig

    tested = {
        "info",
        "delete_episodes",
        "split",
        "merge",
        "remove_feature",
        "modify_tasks",
        "recompute_stats",
    }
    tested |= {"reencode_videos", "convert_image_to_video"}
    assert set(OperationConfig.get_known_choices()) == tested


def test_the_transform_viewer_shows_the_first_image_of_a_dataset_in_lerobots_folder(written, tmp_path):
    """This command takes no ``--root``; LeRobot reads its folder from the environment as it is imported."""
    (tmp_path / "home/local").mkdir(parents=True)
    (tmp_path / "home/local/test").symlink_to(written)
    command = [imported_process.installed("lerobot-imgtransform-viz"), "--repo_id=local/test"]
    environment = os.environ | {"HF_LEROBOT_HOME": str(tmp_path / "home")}
    environment["HF_DATASETS_CACHE"] = str(tmp_path / "cache")
    subprocess.run([*command, "--image_transforms.enable=true"], cwd=tmp_path, env=environment, check=True)
    shown = tmp_path / "outputs/image_transforms/test"
    assert (shown / "original_frame.png").is_file() and (shown / "brightness/max.png").is_file()


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # LeRobot ends without closing it
def test_the_viewer_command_saves_every_frame_of_an_episode(written, tmp_path):
    pytest.importorskip("rerun", reason="needs Rerun of the extra viewer: uv pip install -e '.[viewer]'")
    from rerun.experimental import RrdReader

    _run(imported_process.installed("lerobot-dataset-viz"), "--repo-id=local/test", f"--root={written}",
         "--episode-index=2", "--num-workers=0", "--save=1", f"--output-dir={tmp_path}")  # fmt: skip
    rows = Counter()
    for chunk in RrdReader(tmp_path / "local_test_episode_2.rrd").stream():
        rows[chunk.entity_path] += chunk.num_rows
    length = DatasetInfo.open(written).episode_lengths[2]
    for shown in ("observation.images.front", "state", "action", "next.reward", "next.success"):
        assert rows[f"/{shown}"] == length, shown


# --- LeRobot's streaming reader, as docs/concepts/dataset.md has it ------------------------------------


def _stream(root) -> dict[int, dict]:
    """Returns the frames that LeRobot's streaming reader yields, by index."""
    from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset

    stream = StreamingLeRobotDataset("local/test", root=root, shuffle=False)
    return {int(frame["index"]): frame for frame in stream}


@pytest.fixture
def decodes_by_pyav(monkeypatch):
    """PyAV in place of torchcodec, which LeRobot's streaming reader takes alone and which needs FFmpeg."""
    from lerobot.datasets import streaming_dataset
    from lerobot.datasets.video_utils import decode_video_frames

    def decode(path, timestamps, tolerance_s, **_others):
        return decode_video_frames(path, timestamps, tolerance_s, "pyav")

    monkeypatch.setattr(streaming_dataset, "decode_video_frames_torchcodec", decode)


@pytest.mark.skipif(find_spec("torchcodec") is not None, reason="torchcodec is installed")
def test_lerobots_streaming_reader_asks_for_torchcodec(written):
    with pytest.raises(ImportError, match="'torchcodec' is required"):
        _stream(written)


def test_lerobots_streaming_reader_finds_no_second_video_of_a_camera(written, decodes_by_pyav):
    """When LeRobot heeds where an episode's video begins, the page need not ask for a merge."""
    from lerobot.datasets.video_utils import FrameTimestampError

    with pytest.raises(FrameTimestampError):
        _stream(written)


def test_lerobots_streaming_reader_yields_every_frame_after_the_command_of_the_page(
    written, tmp_path, open_with_lerobot, decodes_by_pyav
):
    (shown,) = re.findall(r"^lerobot-edit-dataset (.*type=merge.*)$", PAGE.read_text(), re.MULTILINE)
    merged = tmp_path / "merged"
    places = {"datasets/PickCube/…": str(written), "datasets/merged": str(merged)}
    for place, folder in places.items():
        assert shown.count(place) == 1
        shown = shown.replace(place, folder)
    _run(imported_process.installed("lerobot-edit-dataset"), *shlex.split(shown))
    found, stock = _stream(merged), open_with_lerobot(written)
    assert sorted(found) == list(range(len(stock)))
    for index in (0, len(stock) // 2, len(stock) - 1):
        expected = stock[index]
        assert torch.equal(found[index]["observation.state"], expected["observation.state"])
        image = expected["observation.images.front"].float() / 255
        torch.testing.assert_close(found[index]["observation.images.front"], image)
