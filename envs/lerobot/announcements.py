"""When LeRobot's recorder begins an episode.

No method of LeRobot's ``Robot`` says where an episode begins: ``lerobot-record`` and ``lerobot-rollout``
expect a person to put things back. They do announce each episode in the log (``log_say`` of
``lerobot.utils.utils``), with the text below in LeRobot 0.6.
"""

import logging
from collections.abc import Callable
from typing import override

RECORDING = "Recording episode "
"""Begins the announcement of an episode whose frames are kept."""


class EpisodeAnnouncements(logging.Handler):
    """Calls a function when an episode is announced.

    Args:
        on_episode: What is called.
    """

    def __init__(self, on_episode: Callable[[], None]) -> None:
        super().__init__(logging.INFO)
        self._on_episode = on_episode

    def __enter__(self) -> "EpisodeAnnouncements":
        """Listens from now on."""
        logging.getLogger().addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        """Listens no more."""
        logging.getLogger().removeHandler(self)

    @override
    def emit(self, record: logging.LogRecord) -> None:
        if record.getMessage().startswith(RECORDING):
            self._on_episode()
