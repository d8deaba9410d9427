"""Starts as in the middle of a chain: states of scene D in which the task before has just ended.

``chain_states.npz`` has them, from 600 chains of 74040727's expert (``python -m benchmark.calvin_states``):
none of the evaluation's, although three have the tasks of one of these, from another start. It has joints of
the arm and of the table, blocks, what touches them, and the symbolic state. Nothing moves. Shapes: N states.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Self

import numpy as np
import torch

from envs.core.atomic import atomic_path
from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.calvin import memory
from envs.tasks.calvin.catalogue import BLOCKS, task_facts
from envs.tasks.calvin.rules import may_be_met
from envs.tasks.calvin.scene import ROBOT, TABLE
from envs.tasks.calvin.sequences import Symbols, after, start_symbols
from envs.tasks.calvin.starts import put_together

FILE = Path(__file__).with_name("chain_states.npz")


@dataclass(frozen=True, slots=True)
class ChainStates:
    """States in which a task of a chain has ended.

    Attributes:
        qpos: Joints of the robot, rad and m, (N, 9).
        targets: Targets of its driven joints, (N, 9).
        table: Joints of the table, m, (N, 4).
        blocks: Position and orientation of each block, in the order of ``BLOCKS``, (N, 3, 7).
        touches: What touches each block, as :func:`envs.tasks.calvin.memory.touches` says, (N, 3).
        led: Whether the LED is lit, (N,).
        symbols: Values of the symbolic state as text, in the order of its keys in ``start_symbols``, (N, 8).
    """

    qpos: np.ndarray
    targets: np.ndarray
    table: np.ndarray
    blocks: np.ndarray
    touches: np.ndarray
    led: np.ndarray
    symbols: np.ndarray

    @classmethod
    def of(cls, state: State, symbols: Sequence[Symbols]) -> Self:
        """Returns the states of environments (N) whose symbolic states are these."""
        robot = state.robots[ROBOT.name]
        assert robot.joint_target is not None, "a state of a simulator has targets"
        blocks = [state.objects[f"block_{colour}"] for colour in BLOCKS]
        return cls(
            qpos=robot.joint_pos.cpu().numpy(),
            targets=robot.joint_target.cpu().numpy(),
            table=state.objects[TABLE].joint_pos.cpu().numpy(),
            blocks=torch.stack([torch.cat([b.pos, b.rot], -1) for b in blocks], 1).cpu().numpy(),
            touches=torch.stack([memory.touches(state, c) for c in BLOCKS], -1).cpu().numpy(),
            led=memory.led(state)[1].cpu().numpy(),
            symbols=np.array([[str(row[key]) for key in _keys()] for row in symbols]),
        )

    @classmethod
    def joined(cls, parts: Sequence["ChainStates"]) -> Self:
        """Returns the states of all parts, one after another."""
        return cls(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in cls.__slots__})

    def save(self, path: Path) -> None:
        """Writes a file, atomically."""
        arrays = {name: getattr(self, name) for name in self.__slots__}
        arrays |= {name: arrays[name].astype(np.float32) for name in ("qpos", "targets", "table", "blocks")}
        arrays["touches"] = arrays["touches"].astype(np.int16)
        with atomic_path(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def load(cls, path: Path = FILE) -> Self:
        """Reads a file."""
        with np.load(path, allow_pickle=False) as arrays:
            return cls(**{name: arrays[name] for name in cls.__slots__})

    def state(self, rows: np.ndarray, robot: RobotCfg) -> State:
        """Returns some of the states as starts of episodes.

        Args:
            rows: Which, (n,).
            robot: The robot, at its place.
        """
        blocks = {}
        for index, colour in enumerate(BLOCKS):
            poses = self.blocks[rows, index].astype(np.float64)
            rot = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
            blocks[colour] = (poses[:, :3], rot)
        return put_together(
            robot,
            self.qpos[rows],
            self.targets[rows].astype(np.float64),
            self.table[rows],
            blocks,
            {colour: self.touches[rows, i].astype(np.int64) for i, colour in enumerate(BLOCKS)},
            self.led[rows],
        )


@cache
def states_before(task: str) -> tuple[ChainStates, np.ndarray]:
    """Returns the file's states, and those in which a task can be done by symbols, contacts and lights, (n,).

    Contacts leave some out, as where the hand still touches the block to be lifted off another one: 6 % of
    the states whose symbols allow ``push_into_drawer``, 4 % of ``unstack_block``, 2 % at most of the others.
    """
    states, symbols = _file()
    rows = np.array([row for row, values in enumerate(symbols) if after(values, task)])
    able = may_be_met(task_facts()[task].rule, states.state(rows, ROBOT)).numpy()
    return states, rows[able]


@cache
def _file() -> tuple[ChainStates, list[dict[str, int | str]]]:
    """Returns the file's states, and the symbolic state of each."""
    states = ChainStates.load()
    return states, [_symbols(values) for values in states.symbols.tolist()]


def _symbols(values: Sequence[str]) -> dict[str, int | str]:
    return {key: int(text) if text.isdigit() else text for key, text in zip(_keys(), values, strict=True)}


def _keys() -> tuple[str, ...]:
    return tuple(start_symbols()[0])
