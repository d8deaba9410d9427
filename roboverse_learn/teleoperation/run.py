"""A run of teleoperation: environments, sessions and threads, with a page or with a scripted person."""

import asyncio
import contextlib
import logging
import ssl
import threading
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envs.core.errors import ConfigError
from envs.core.machine import num_cores
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.config.other_commands import TeleoperateConfig
from roboverse_learn.teleoperation.certificate import addresses, tls_of
from roboverse_learn.teleoperation.conductor import Conductor, Figures
from roboverse_learn.teleoperation.episode_book import EpisodeBook
from roboverse_learn.teleoperation.recording import RecordingFolder, scene_of
from roboverse_learn.teleoperation.scripted_person import ExpertCorrector, ExpertHand, ExpertPerson
from roboverse_learn.teleoperation.session import Phase, Session
from roboverse_learn.teleoperation.station import Station, check_steerable

if TYPE_CHECKING:
    from roboverse_learn.teleoperation.policy_driver import PolicyDriver

_POLL_S = 0.1

GIVE_UP_AFTER = 20
"""Episodes without a success after which the expert no longer steers."""

log = logging.getLogger(__name__)


@dataclass(kw_only=True)
class Steering:
    """Everything that a run of teleoperation consists of, but its page.

    Attributes:
        env: The environments.
        book: Episodes and recordings.
        sessions: One per environment.
        folder: The recordings.
        drawing: Held while something is rendered.
    """

    env: RoboVerseVectorEnv
    book: EpisodeBook
    sessions: list[Session]
    folder: RecordingFolder
    drawing: "threading.Lock" = field(default_factory=threading.Lock)

    @property
    def nothing_to_do(self) -> str:
        """Why nobody needs to steer, and how to record more; empty where there is something to steer."""
        if any(session.phase is not Phase.OVER for session in self.sessions):
            return ""
        kept, wanted = self.book.kept, self.book.wanted
        if not self.book.is_full:
            return (
                f"'{self.folder.root}' holds {kept} of {wanted} successes, and no episode of the train split "
                "is left to steer. Record in another folder: recordings=<folder>."
            )
        return (
            f"'{self.folder.root}' already holds {kept} of {wanted} successes. Record more with "
            f"num_demos={kept + wanted}, or in another folder with recordings=<folder>."
        )


@contextlib.contextmanager
def prepared(config: TeleoperateConfig, recordings: Path) -> Iterator[Steering]:
    """Makes the environments and opens the folder of recordings; both are closed at the end.

    Raises:
        ConfigError: The task cannot be teleoperated.
        DatasetError: The folder holds recordings of another scene.
        LockedError: Another process writes to it.
    """
    drawing, people = threading.Lock(), range(config.operators)
    with contextlib.ExitStack() as stack:
        env = view_env(config)
        stack.callback(env.close)
        check_steerable(env)
        folder = RecordingFolder(recordings, scene_of(env.env_spec))
        stack.callback(folder.close)
        book = EpisodeBook(folder, pool_of(env, corrects=bool(config.checkpoint)), config.num_demos)
        # What a policy observes has its shadows; a page leaves them out where one core does everything.
        usual = num_cores() > 1 if config.view_shadows is None else config.view_shadows
        shadows = bool(config.checkpoint) or usual
        stations = [Station(env, index, drawing, shadows=shadows) for index in people]
        drivers = [_driver(config, env) for _ in people]
        sessions = [
            Session(station, book, limit_s=config.limit_s, driver=driver)
            for station, driver in zip(stations, drivers, strict=True)
        ]
        yield Steering(env=env, book=book, sessions=sessions, folder=folder, drawing=drawing)


def pool_of(env: RoboVerseVectorEnv, *, corrects: bool) -> list[int]:
    """Returns the episodes of the split in the order in which they are steered.

    Experts demonstrate from the first episode on, persons from the last one back, and policies are corrected
    from the middle on: merging datasets keeps one of several demonstrations of an episode.
    """
    episodes = env.split_indices.tolist()
    middle = len(episodes) // 2
    return episodes[middle:] + episodes[:middle] if corrects else episodes[::-1]


def view_env(config: TeleoperateConfig) -> RoboVerseVectorEnv:
    """Returns the environments, with the cameras and image size of the page; the dataset's come first."""
    if config.checkpoint:  # what the page shows is what the policy observes
        return config.env.make(config.operators)
    every = tuple(camera.name for camera in config.env.make_task().scenario.cameras)
    cameras = config.view_cameras or tuple(dict.fromkeys((*config.env.cameras, *every)))
    spec = config.env.replace(cameras=cameras, image_size=config.view_size)
    return spec.make(config.operators, observation="pixels")


def _driver(config: TeleoperateConfig, env: RoboVerseVectorEnv) -> "PolicyDriver | None":
    """Returns the policy of the checkpoint, one for each environment: they share nothing."""
    if not config.checkpoint:
        return None
    from roboverse_learn.teleoperation.policy_driver import load_driver

    return load_driver(config, env)


def steer_by_expert(steering: Steering) -> None:
    """Lets the expert steer until there are enough successes, without waiting for the clock.

    Raises:
        ConfigError: The task has no expert, or none of its first episodes succeeds.
    """
    task, book = steering.env.task, steering.book
    kept = book.kept
    if not task.has_expert:
        raise ConfigError(f"{task.name} has no expert that could steer. Leave out actor=expert.")
    people = [_expert(steering, session) for session in steering.sessions]
    while any(session.phase is not Phase.OVER for session in steering.sessions):
        for person, session in zip(people, steering.sessions, strict=True):
            person.tick()
            session.tick()
        if book.num_over >= GIVE_UP_AFTER and book.kept == kept:
            raise ConfigError(
                f"The expert of {task.name} solved none of {book.num_over} episodes by steering the hand. "
                "Leave out what differs from the task's own scene, or raise limit_s."
            )


def _expert(steering: Steering, session: Session) -> ExpertPerson:
    hand = ExpertHand(session.station, steering.env.task.planner, steering.env.protocol_seed)
    if session.has_driver:
        return ExpertCorrector(session, hand, steering.env.max_episode_steps)
    return ExpertPerson(session, hand)


def steer_by_page(steering: Steering, config: TeleoperateConfig) -> Figures:
    """Serves the page until there are enough successes, or the user interrupts; returns how time was kept.

    Raises:
        ConfigError: The port is taken, or the certificate is none.
    """
    return asyncio.run(_serve(steering, config))


async def _serve(steering: Steering, config: TeleoperateConfig) -> Figures:
    context = tls_of(config.host, config.cert, config.key, https=config.https)
    async with conducted(steering, config.host, config.port, context) as (conductor, url):
        for host in addresses(config.host):
            log.info("Open %s in a browser. Ctrl+C ends it.", url.replace(config.host, host, 1))
        try:
            while not conductor.is_over:
                await asyncio.sleep(_POLL_S)
        except asyncio.CancelledError:  # Ctrl+C: what is recorded becomes a dataset
            kept = steering.book.kept
            log.info("Interrupted: %s recorded.", "1 success is" if kept == 1 else f"{kept} successes are")
            task = asyncio.current_task()
            assert task is not None, "a coroutine runs in a task"
            task.uncancel()
    if conductor.error is not None:
        raise conductor.error
    return conductor.figures()


@contextlib.asynccontextmanager
async def conducted(
    steering: Steering, host: str, port: int, context: ssl.SSLContext | None = None
) -> AsyncIterator[tuple[Conductor, str]]:
    """Runs the sessions behind a server; yields what ticks them, and the page's address.

    Raises:
        ConfigError: The port is taken.
    """
    from roboverse_learn.teleoperation.server import TeleoperationServer

    server = TeleoperationServer(steering.sessions, page_facts(steering))
    sent = -1

    def on_status(index: int, status: dict[str, Any]) -> None:
        nonlocal sent
        server.send_status(index, status)
        if steering.book.revision != sent:
            sent = steering.book.revision
            server.send_episodes(steering.book.rows())

    conductor = Conductor(
        steering.env,
        steering.sessions,
        drawing=steering.drawing,
        on_status=on_status,
        on_frame=server.show,
    )
    listening = await server.start(host, port, context)
    try:
        await asyncio.to_thread(conductor.start)
        yield conductor, f"{'https' if context else 'http'}://{host}:{listening}/{server.token}/"
    finally:
        conductor.stop()
        await server.stop()


def page_facts(steering: Steering) -> dict[str, Any]:
    """Returns what the page is sent at first, as JSON values."""
    env, station = steering.env, steering.sessions[0].station
    return {
        "task": env.task.name,
        "control_hz": station.control_hz,
        "cameras": list(env.camera_names),
        "size": [env.scenario.cameras[0].width, env.scenario.cameras[0].height],
        "delta_m": station.controller.delta_m,
        "delta_rad": station.controller.delta_rad,
    }
