"""LeRobot's own tools on a dataset of ours: its facts, its readers, without noise."""

import pytest
import torch

from tests import imported_process

pytestmark = pytest.mark.slow


def _run(*words) -> str:
    """Returns what a program prints, errors too."""
    done = imported_process.run(*words)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


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


def test_lerobots_streaming_reader_yields_every_frame_of_a_dataset_that_lerobot_has_merged(
    written, tmp_path, open_with_lerobot, monkeypatch
):
    """It takes all episodes of a camera to lie in one video, as LeRobot's merge leaves them.

    It decodes by torchcodec alone, which needs FFmpeg; PyAV stands for it here.
    """
    from lerobot.datasets import streaming_dataset
    from lerobot.datasets.aggregate import aggregate_datasets
    from lerobot.datasets.video_utils import decode_video_frames

    def decode(path, timestamps, tolerance_s, **_others):
        return decode_video_frames(path, timestamps, tolerance_s, "pyav")

    monkeypatch.setattr(streaming_dataset, "decode_video_frames_torchcodec", decode)
    merged = tmp_path / "merged"
    aggregate_datasets(["local/test"], "local/merged", roots=[written], aggr_root=merged)
    stream = streaming_dataset.StreamingLeRobotDataset("local/merged", root=merged, shuffle=False)
    found = {int(frame["index"]): frame for frame in stream}
    stock = open_with_lerobot(written)
    assert sorted(found) == list(range(len(stock)))
    for index in (0, len(stock) // 2, len(stock) - 1):
        expected = stock[index]
        assert torch.equal(found[index]["observation.state"], expected["observation.state"])
        image = expected["observation.images.front"].float() / 255
        torch.testing.assert_close(found[index]["observation.images.front"], image)
