"""The GIF of one of CALVIN's chains: a policy follows five instructions, each from where the last one ended.

``python -m docs.generate.calvin_gif checkpoint=runs/mtact_calvin`` writes ``docs/howto/calvin_chain.gif``.
"""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from benchmark.calvin_chains import ENV_TASK, ChainEnv, chain_actor, run_chains
from docs.generate.rollouts_gif import save_gif
from envs.core.arguments import run_program
from envs.core.errors import ConfigError
from envs.rollout import Episode
from envs.spec import EnvSpec
from envs.state import State
from envs.tasks.calvin.sequences import all_chains
from roboverse_learn.commands.tested_checkpoint import checkpoint_to_test
from roboverse_learn.commands.tested_policy import load_policy, view_of
from roboverse_learn.config.compose import compose

logger = logging.getLogger(__name__)

CAPTION_PX, TEXT_PX = 32, 15

HZ = 30
"""Control steps in a second, of CALVIN's tasks."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ChainSettings:
    """Writes the GIF of a chain.

    Attributes:
        checkpoint: Run folder of a policy that learned CALVIN's tasks.
        chain: Index of the chain, 0 to 999.
        out: The GIF.
        pixels: Its width.
        every: Control steps from one frame to the next, of 30 in a second.
    """

    checkpoint: str = ""
    chain: int = 0
    out: Path = Path("docs/howto/calvin_chain.gif")
    pixels: int = 320
    every: int = 4


@dataclass(frozen=True, slots=True)
class Shot:
    """The scene at one moment, and what is asked for.

    Attributes:
        state: Of one row.
        instruction: The instruction.
    """

    state: State
    instruction: str


def filmed(settings: ChainSettings) -> list[Shot]:
    """Returns the scene every so many control steps, and at the end."""
    words = [f"checkpoint={settings.checkpoint}", f"task={ENV_TASK}", "simulator=mujoco", "device=cpu"]
    tested = checkpoint_to_test(compose("evaluate", words))
    env = tested.env.make(1, split="test", **view_of(tested.checkpoint))
    chains = ChainEnv(env, {settings.chain: all_chains()[settings.chain]})
    shots: list[Shot] = []

    def film(episode: Episode) -> None:
        if episode.length % settings.every == 0:
            shots.append(Shot(env.get_states([0]), env.instruction(0)))

    try:
        actor = chain_actor(load_policy(tested), chains)
        ((_, solved),) = run_chains(chains, actor, [settings.chain], on_step=film)
        shots.append(Shot(env.get_states([0]), shots[-1].instruction))
    finally:
        env.close()
    logger.info("%d of 5 solved", solved)
    return shots


def frames(shots: Sequence[Shot], pixels: int) -> list[Image.Image]:
    """Returns the static camera's image of each, with the instruction below."""
    env = EnvSpec(task=ENV_TASK, cameras=("static",), image_size=pixels).make(1, observation="state")
    font, made = ImageFont.load_default(TEXT_PX), []
    try:
        for shot in shots:
            env.handler.set_states(shot.state)
            frame = Image.new("RGB", (pixels, pixels + CAPTION_PX), "white")
            frame.paste(Image.fromarray(env.image(0)))
            middle = pixels / 2, pixels + CAPTION_PX / 2
            ImageDraw.Draw(frame).text(middle, shot.instruction, "black", font, anchor="mm")
            made.append(frame)
    finally:
        env.close()
    return made


def main(words: Sequence[str] | None = None) -> int:
    """Writes the GIF; returns the exit code."""
    return run_program("python -m docs.generate.calvin_gif", ChainSettings, _write, words)


def _write(settings: ChainSettings) -> None:
    if not settings.checkpoint:
        raise ConfigError("No policy was named. Add checkpoint=<run folder of recipe=mtact_calvin>.")
    shown = frames(filmed(settings), settings.pixels)
    save_gif(settings.out, shown, 1000 * settings.every / HZ)


if __name__ == "__main__":
    sys.exit(main())
