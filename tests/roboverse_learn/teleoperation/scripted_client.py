"""A client of the public protocol that plays what an expert would, from the statuses that it is sent."""

import asyncio
import json
import struct
from collections import deque
from typing import Any

import aiohttp
import numpy as np
import torch

from envs.kinematics.forward import rotation_vector
from envs.randomization import channel_rng
from envs.rotations import to_matrix
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.teleoperation.station import Station

GAIN = 0.6
"""Share of the remaining way that is asked for at once: an answer may be a step late."""


class Follower:
    """Follows the expert's plan of an episode by the hand's poses in the statuses of a server.

    Args:
        env: An environment of the client's own, in which it plans.
    """

    def __init__(self, env: RoboVerseVectorEnv) -> None:
        self._env, self._station = env, Station(env, 0)
        self._goals: deque[tuple[np.ndarray, np.ndarray, float]] = deque()

    def begin(self, episode: int) -> None:
        """Plans an episode from its start."""
        self._station.start(episode)
        rng = channel_rng(self._env.protocol_seed, "expert", episode)
        plan = torch.from_numpy(self._env.task.planner.plan(self._station.state, rng)).double()
        controller = self._station.controller
        joints = plan.clone()
        pos, rot = controller.target_pose(joints, plan)
        grips = controller.gripper_entry(plan).clamp(-1.0, 1.0)
        self._goals = deque(zip(pos.numpy(), rot.numpy(), grips.tolist(), strict=True))

    def motion(self, hand: dict[str, Any]) -> tuple[list[float], float]:
        """Returns the rate, in the world's axes, and the gripper that lead along the plan."""
        pos, rot = np.array(hand["pos"]), to_matrix(np.array(hand["rot"]))
        while True:
            goal, turned, gripper = self._goals[0]
            way = goal - pos
            turn = rotation_vector(torch.from_numpy(turned @ rot.T)[None])[0].numpy()
            grips = len(self._goals) > 1 and abs(self._goals[1][2] - gripper) > 0.05
            last = len(self._goals) == 1
            near = np.linalg.norm(way) < (0.003 if grips or last else 0.02) and np.linalg.norm(turn) < 0.1
            if last or not near:
                break
            self._goals.popleft()
            if grips:
                break
        controller = self._station.controller
        rate = np.concatenate([way / controller.delta_m, turn / controller.delta_rad])
        return np.clip(GAIN * rate, -1.0, 1.0).round(5).tolist(), float(gripper)


class Client:
    """One websocket, with what it was sent."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.hello: dict[str, Any] = {}
        self.status: dict[str, Any] = {}
        self.rows: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []
        self.jpeg = b""
        self.delays_s: list[float] = []
        self._sent_at: dict[int, float] = {}
        self._seq = 0

    async def say(self, **message: Any) -> None:
        await self.socket.send_str(json.dumps(message))

    async def join(self, client: str = "client", operator: str = "") -> None:
        await self.say(type="join", client=client, operator=operator)

    async def move(self, rate: list[float], gripper: float) -> None:
        self._seq += 1
        self._sent_at[self._seq] = asyncio.get_running_loop().time()
        seen = self.frames[-1]["frame"] if self.frames else 0
        await self.say(type="move", seq=self._seq, rate=rate, gripper=gripper, device="script", seen=seen)

    async def read(self, seconds: float = 20.0) -> str:
        """Reads one message; returns its type."""
        message = await self.socket.receive(seconds)
        if message.type is aiohttp.WSMsgType.BINARY:
            (size,) = struct.unpack_from("<I", message.data)
            header = json.loads(message.data[4 : 4 + size])
            assert 4 + size + sum(header["images"].values()) == len(message.data)
            self.jpeg = message.data[4 + size :]
            self.frames.append(header)
            if sent := self._sent_at.get(header["seq"]):
                self.delays_s.append(asyncio.get_running_loop().time() - sent)
                self._sent_at = {seq: at for seq, at in self._sent_at.items() if seq > header["seq"]}
            return "frame"
        assert message.type is aiohttp.WSMsgType.TEXT, (message.type, message.data, message.extra)
        found = json.loads(message.data)
        if found["type"] == "episodes":
            self.rows = found["rows"]
        else:
            setattr(self, found["type"], found)
        return found["type"]

    async def until(self, kind: str, **fields: Any) -> None:
        """Reads until a message of a kind whose fields have these values."""
        async with asyncio.timeout(60):
            while True:
                if await self.read() == kind and all(getattr(self, kind)[k] == v for k, v in fields.items()):
                    return


async def play(client: Client, follower: Follower) -> None:
    """Plays the present episode until it is over, one motion for each status."""
    episode = client.status["episode"]
    follower.begin(episode)
    await client.say(type="press", button="start")
    await client.until("status", phase="running")
    while client.status["episode"] == episode:
        await client.move(*follower.motion(client.status["hand"]))
        while await client.read() != "status":
            await client.move(*follower.motion(client.status["hand"]))
