"""Records demonstrations in LIBERO's own environment, as LeRobot shows it, with the actions of our expert.

Images, state and success are the original's; a policy that was trained on them has seen nothing of ours. The first and
the third step run in the environment of ``docs/generate/libero_starts.py``, the second in that of this project:

    original/bin/python docs/generate/libero_demonstrations.py starts starts.npy 60
    .venv/bin/python docs/generate/libero_demonstrations.py actions starts.npy actions.npz
    original/bin/python docs/generate/libero_demonstrations.py record starts.npy actions.npz original_stove

The original draws objects in the regions of its task file; noise of the arm is that of LIBERO's own 50 states, none of
which is used. Recording takes 16 s a demonstration where OSMesa renders on one core. The folder is a LeRobotDataset.
"""  # noqa: E501

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

SUITE, TASK_ID, TASK = "libero_goal", 7, "libero/goal/turn_on_the_stove"
PX, FPS, NOISE_RAD, NUM_ENVS = 64, 20, 0.02, 8
STATE = ["x", "y", "z", "axis_angle_x", "axis_angle_y", "axis_angle_z", "finger_1", "finger_2"]
ACTION = ["x", "y", "z", "roll", "pitch", "yaw", "gripper"]
IMAGES = ("image", "image2")


def starts(file: str, count: str) -> None:
    """Writes states of the original's resets, seeds from 0 on, (count, D), as rows of its files of starts."""
    from libero.libero import benchmark, get_libero_path
    from libero.libero.envs.env_wrapper import ControlEnv

    task = benchmark.get_benchmark_dict()[SUITE]().get_task(TASK_ID)
    bddl = Path(get_libero_path("bddl_files")) / task.problem_folder / task.bddl_file
    env = ControlEnv(str(bddl), use_camera_obs=False, has_offscreen_renderer=False, camera_names=[])
    rng, rows = np.random.default_rng(0), []
    for seed in range(int(count)):
        env.seed(seed)
        env.reset()
        row = env.env.sim.get_state().flatten().copy()
        row[1:8] += rng.normal(0.0, NOISE_RAD, 7)
        rows.append(row)
    np.save(file, np.stack(rows))


def actions(starts_file: str, file: str) -> None:
    """Writes the expert's actions (T, 7) here, from each of these starts in which it succeeds."""
    from envs.experts.actor import expert_episodes
    from envs.spec import EnvSpec
    from envs.tasks.libero.catalogue import entries
    from envs.tasks.libero.scene import scene_of
    from envs.tasks.libero.seating import Seater, with_poses
    from envs.tasks.libero.start_files import states_of_rows
    from envs.tasks.libero.starts import starts_of

    rows = np.load(starts_file)
    entry = entries()[TASK]
    scene = scene_of(entry)
    states = states_of_rows(scene, rows)
    starts_of(entry).fixed = with_poses(scene, states, Seater(scene).poses(states))
    native = {"action_space": "native", "observation_space": "native", "starts": "libero"}
    env = EnvSpec(task=TASK, task_kwargs=native).make(min(NUM_ENVS, len(rows)))
    numbers = {int(index): number for number, index in enumerate(env.split_indices[: len(rows)])}
    found = {
        str(numbers[int(episode.episode)]): episode.actions
        for episode in expert_episodes(env, list(numbers), record=())
        if episode.success
    }
    env.close()
    np.savez(file, **found)


def record(starts_file: str, actions_file: str, folder: str) -> None:
    """Replays the actions in LeRobot's environment, and writes episodes that it calls a success."""
    os.environ.setdefault("MUJOCO_GL", "osmesa")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.envs.configs import LiberoEnv
    from lerobot.envs.utils import preprocess_observation

    config = LiberoEnv(task=SUITE, task_ids=[TASK_ID], observation_height=PX, observation_width=PX)
    env, (process, _) = config.create_envs(1)[SUITE][TASK_ID], config.get_env_processors()
    original = env.envs[0].unwrapped
    original._init_states = np.load(starts_file)
    dataset = LeRobotDataset.create(
        repo_id=f"local/{Path(folder).name}",
        root=folder,
        fps=FPS,
        robot_type="panda",
        features=features(),
        use_videos=False,
    )
    with np.load(actions_file) as demonstrated:
        for number in demonstrated.files:
            original.init_state_id = int(number)
            observation, frames, solved = env.reset(seed=[int(number)])[0], [], False
            for action in demonstrated[number].astype(np.float32):
                frames.append(frame(process(preprocess_observation(observation)), action, original))
                observation, _, terminated, _, _ = env.step(action[None])
                if solved := bool(terminated[0]):
                    break
            if solved:
                for values in frames:
                    dataset.add_frame(values)
                dataset.save_episode()
            sys.stdout.write(f"{number} {'success' if solved else 'failure'} {len(frames)}\n")
    dataset.finalize()
    env.close()


def features() -> dict[str, dict[str, Any]]:
    """Returns the features of the dataset: names and sizes of LeRobot's public datasets of LIBERO."""
    image = {"dtype": "image", "shape": (PX, PX, 3), "names": ["height", "width", "channel"]}
    return {
        **{f"observation.images.{name}": dict(image) for name in IMAGES},
        "observation.state": {"dtype": "float32", "shape": (len(STATE),), "names": STATE},
        "action": {"dtype": "float32", "shape": (len(ACTION),), "names": ACTION},
    }


def frame(seen: dict[str, Any], action: np.ndarray, original: Any) -> dict[str, Any]:
    """Returns a frame of the dataset.

    Args:
        seen: An observation of one environment as policies get it: images (1, 3, H, W) from 0 to 1.
        action: What is done then, (7,).
        original: LeRobot's environment, which has the instruction.
    """
    images = {
        key: np.round(255 * np.asarray(seen[key][0]).transpose(1, 2, 0)).astype(np.uint8)
        for key in (f"observation.images.{name}" for name in IMAGES)
    }
    state = np.asarray(seen["observation.state"][0], np.float32)
    return {**images, "observation.state": state, "action": action, "task": original.task_description}


if __name__ == "__main__":
    {"starts": starts, "actions": actions, "record": record}[sys.argv[1]](*sys.argv[2:])
