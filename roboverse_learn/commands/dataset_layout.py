"""Features, frames per second and robot of a dataset that is there, or will be collected."""

from typing import Any

from roboverse_learn.config.schema import CollectConfig, TrainRunConfig
from roboverse_learn.data.sources import SOURCES


def dataset_layout(config: CollectConfig) -> tuple[dict[str, Any], int, str]:
    """Returns the features, the frames per second and the robot of the given dataset, or of the task's."""
    from roboverse_learn.data.dataset.info import DatasetInfo

    if not (isinstance(config, TrainRunConfig) and config.dataset):
        return task_layout(config)
    info = DatasetInfo.open(config.dataset)
    # Images that are stored one by one are learned from as those of videos are.
    features = {
        key: {**feature, "dtype": "video"} if key in info.camera_keys else feature
        for key, feature in info.features.items()
    }
    return features, info.fps, info.robot_type or ""


def task_layout(config: CollectConfig) -> tuple[dict[str, Any], int, str]:
    """Returns the features, the frames per second and the robot of a task's dataset."""
    from roboverse_learn.data.dataset.schema import make_features

    task = config.env.make_task()
    scenario = task.scenario.seen_by(config.env.cameras, config.env.image_size)
    cameras = {camera.name: (camera.height, camera.width) for camera in scenario.cameras}
    further = dict.fromkeys(SOURCES.get(config.source).columns, True)
    features = make_features(task.state_names, task.controller.names, cameras, **further)
    kind = "+".join(robot.lerobot_type or robot.name for robot in task.robots)
    return features, round(scenario.physics.control_hz), kind
