"""PickCube with an arm to steer, without images."""

from collections.abc import Callable

import pytest

from envs.spec import EnvSpec
from roboverse_learn.teleoperation.episode_book import EpisodeBook
from roboverse_learn.teleoperation.recording import RecordingFolder, scene_of
from roboverse_learn.teleoperation.session import Session
from roboverse_learn.teleoperation.station import Station

MakeSession = Callable[..., Session]


@pytest.fixture(scope="session")
def pick_cube():
    env = EnvSpec(task="PickCube").make(2, observation="state", num_threads=1)
    yield env
    env.close()


@pytest.fixture
def folder(pick_cube, tmp_path):
    opened = RecordingFolder(tmp_path / "recordings", scene_of(pick_cube.env_spec))
    yield opened
    opened.close()


@pytest.fixture
def book(pick_cube, folder):
    return EpisodeBook(folder, pick_cube.split_indices.tolist()[:4], wanted=2)


@pytest.fixture
def make_session(pick_cube, book) -> MakeSession:
    def make(env_id: int = 0, **options) -> Session:
        session = Session(Station(pick_cube, env_id), book, **options)
        session.connected = True
        return session

    return make
