"""Steps one of ManiSkill's environments for another process, and records it by ManiSkill's own recorder.

:mod:`docs.generate.maniskill_recordings` starts it, with the Python of an environment of its own, which has
ManiSkill and nothing of this project. It reads a line of JSON for each request and answers by one that begins
with :data:`MARK`.
"""

import json
import sys
from typing import Any

import gymnasium as gym
import mani_skill.envs  # pyright: ignore[reportMissingImports]  # noqa: F401
import numpy as np
from mani_skill.envs.tasks.tabletop import push_t  # pyright: ignore[reportMissingImports]
from mani_skill.utils.wrappers.flatten import FlattenActionSpaceWrapper  # pyright: ignore[reportMissingImports]
from mani_skill.utils.wrappers.record import RecordEpisode  # pyright: ignore[reportMissingImports]
from maniskill_unseen import without_materials  # beside this file, which is run by its path

MARK = "@@"


def main(env_id: str, folder: str) -> None:
    """Answers requests until the input ends."""
    without_materials()
    push_t.WhiteTableSceneBuilder.build = push_t.TableSceneBuilder.build  # a white table needs a renderer
    env: Any = gym.make(
        env_id,
        obs_mode="none",
        control_mode="pd_joint_pos",
        render_backend="none",
        sim_backend="cpu",
        max_episode_steps=10_000,
    )
    if hasattr(env.unwrapped.agent, "agents"):  # the recorder cannot write actions that are a dictionary
        env = FlattenActionSpaceWrapper(env)
    env = RecordEpisode(
        env, folder, trajectory_name="t", save_video=False, record_reward=False, save_on_reset=False,
        source_type="closed loop",
    )  # fmt: skip
    for line in sys.stdin:
        request = json.loads(line)
        if request["do"] == "reset":
            env.reset(seed=request["seed"])
            _answer(_state(env))
        elif request["do"] == "step":
            won = []
            for action in request["actions"]:
                info = env.step(np.array(action, np.float32))[-1]
                won.append(bool(info["success"].item()))
                if won[-1] and request["until_success"]:
                    break
            _answer(_state(env) | {"won": won})
        else:
            env.flush_trajectory(save=request["save"])
            _answer({})
    env.close()


def _state(env: Any) -> dict[str, dict[str, list[float]]]:
    states = env.unwrapped.get_state_dict()
    return {kind: {name: one[0].tolist() for name, one in of.items()} for kind, of in states.items()}


def _answer(values: dict) -> None:
    sys.stdout.write(f"{MARK}{json.dumps(values)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
