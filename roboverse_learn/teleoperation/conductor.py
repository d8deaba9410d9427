"""Ticks sessions at the control rate, and renders what is watched: newest state first, as fast as it goes.

Two threads, so that physics is never late for an image. Rendering works on snapshots of states.
"""

import io
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from envs.core.errors import RoboVerseError
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.teleoperation.scripted_person import ExpertPerson
from roboverse_learn.teleoperation.session import Phase, Session

JPEG_QUALITY = 80
_STATUS_S = 0.5
"""Seconds after which a status is repeated, even where nothing has changed."""

_MOVING_S = 0.1
"""Least seconds between two statuses of a session: a page's figures need no more."""

_KEPT = 20_000
"""Times that are kept for the figures of a run."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """Images of one moment.

    Attributes:
        number: Rises from frame to frame.
        seq: Number of the newest motion that the moment shows.
        step: Control step of the episode.
        jpegs: Camera to image.
    """

    number: int
    seq: int
    step: int
    jpegs: dict[str, bytes]


@dataclass(frozen=True, kw_only=True, slots=True)
class Figures:
    """How well time was kept.

    Attributes:
        ticks: Control steps.
        late_ms: 50th, 95th and 100th percentile of how late they began.
        images: Frames that were rendered.
        image_ms: 50th and 95th percentile of the time to render and encode one.
        images_per_s: Frames per second while an episode ran, of all operators together.
    """

    ticks: int
    late_ms: tuple[float, float, float]
    images: int
    image_ms: tuple[float, float]
    images_per_s: float


class Conductor:
    """Runs sessions until they are done, or :meth:`stop` is called.

    Args:
        env: The environments of the sessions.
        sessions: Session ``i`` steers environment ``i``.
        drawing: Held while something is rendered; the stations' own.
        on_status: Called with a session's index and what its page shows.
        on_frame: Called with a session's index and its newest images.
        people: Scripted persons, each called before a tick.
    """

    def __init__(
        self,
        env: RoboVerseVectorEnv,
        sessions: Sequence[Session],
        *,
        drawing: "threading.Lock | None" = None,
        on_status: Callable[[int, dict[str, Any]], None] = lambda index, status: None,
        on_frame: Callable[[int, Frame], None] = lambda index, frame: None,
        people: Sequence[ExpertPerson] = (),
    ) -> None:
        self._env, self._sessions, self._people = env, sessions, people
        self._on_status, self._on_frame = on_status, on_frame
        self._drawing = drawing or threading.Lock()
        self._state = threading.Lock()  # held while simulated time passes, and while it is looked at
        self._changed, self._stopped = threading.Event(), threading.Event()
        self._late: deque[float] = deque(maxlen=_KEPT)
        self._drawn: deque[float] = deque(maxlen=_KEPT)
        self._running_ticks = self._running_images = 0
        self._threads = [
            threading.Thread(target=self._guarded, args=(body,), name=f"teleoperation {name}", daemon=True)
            for name, body in (("physics", self._tick_on), ("images", self._draw_on))
        ]
        self.error: BaseException | None = None

    def start(self) -> None:
        """Renders once, which compiles the renderer, and starts both threads."""
        with self._drawing:
            self._env.handler.render(None, ("rgb",), [0])
        if not self._stopped.is_set():  # by an interruption meanwhile
            for thread in self._threads:
                thread.start()

    def stop(self) -> None:
        """Ends both threads."""
        self._stopped.set()
        self._changed.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    @property
    def is_over(self) -> bool:
        """Whether there is nothing left to do, and everybody has seen it."""
        over = all(session.phase is Phase.OVER for session in self._sessions)
        seen = all(session.done or not session.connected for session in self._sessions)
        return self._stopped.is_set() or (over and seen)

    def figures(self) -> Figures:
        """Returns how well time was kept so far."""
        late = np.array(self._late or [0.0]) * 1e3
        drawn = np.array(self._drawn or [0.0]) * 1e3
        return Figures(
            ticks=len(self._late),
            late_ms=tuple(np.percentile(late, (50, 95, 100)).round(2).tolist()),
            images=len(self._drawn),
            image_ms=tuple(np.percentile(drawn, (50, 95)).round(2).tolist()),
            images_per_s=round(self._running_images * self._env.control_hz / max(self._running_ticks, 1), 2),
        )

    def _guarded(self, body: Callable[[], None]) -> None:
        try:
            body()
        except BaseException as error:  # shown by the thread that waits for this one
            self.error = error
            self._stopped.set()
            if not isinstance(error, RoboVerseError):
                log.exception("Teleoperation ended by an error.")

    # -- physics -------------------------------------------------------------------------------------

    def _tick_on(self) -> None:
        period = 1.0 / self._env.control_hz
        seen, sent_at = [-1] * len(self._sessions), [0.0] * len(self._sessions)
        due = time.monotonic()
        while not self._stopped.wait(max(due - time.monotonic(), 0.0)):
            now = time.monotonic()
            self._late.append(now - due)
            with self._state:
                for person in self._people:
                    person.tick()
                for session in self._sessions:
                    session.tick()
                changed = [
                    now - sent_at[index] >= (_STATUS_S if session.version == seen[index] else _MOVING_S)
                    for index, session in enumerate(self._sessions)
                ]
                statuses = [
                    session.status() if changes else None
                    for session, changes in zip(self._sessions, changed, strict=True)
                ]
            for index, status in enumerate(statuses):
                if status is not None:
                    self._on_status(index, status)
                    seen[index], sent_at[index] = self._sessions[index].version, now
            self._running_ticks += any(session.phase is Phase.RUNNING for session in self._sessions)
            self._changed.set()
            due = max(due + period, time.monotonic() - period)  # late steps are not made up for in a burst

    # -- images --------------------------------------------------------------------------------------

    def _draw_on(self) -> None:
        shown, number = [-1] * len(self._sessions), 0
        while not self._stopped.is_set():
            self._changed.wait()
            self._changed.clear()
            began = time.perf_counter()
            with self._state:
                watched = [
                    index
                    for index, session in enumerate(self._sessions)
                    if session.connected and session.version != shown[index]
                ]
                moments = [(session.version, session.seq, session.step) for session in self._sessions]
                jobs = self._env.handler.snapshot(watched) if watched else []
                wanted = {index: self._sessions[index].cameras for index in watched}
            if not watched:
                continue
            cameras = [name for name in self._env.camera_names if any(name in of for of in wanted.values())]
            with self._drawing:
                images = self._env.handler.render_jobs(jobs, cameras)
            for row, index in enumerate(watched):
                number += 1
                version, seq, step = moments[index]
                jpegs = {camera: encode_jpeg(images[camera]["rgb"][row]) for camera in wanted[index]}
                self._on_frame(index, Frame(number=number, seq=seq, step=step, jpegs=jpegs))
                shown[index] = version
            self._drawn.append(time.perf_counter() - began)
            self._running_images += sum(self._sessions[index].phase is Phase.RUNNING for index in watched)


def encode_jpeg(image: np.ndarray) -> bytes:
    """Returns the JPEG of an image (H, W, 3) uint8."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()
