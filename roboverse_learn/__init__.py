"""Commands, configuration, data and training: everything that a user starts."""

import logging
import multiprocessing
import signal
import sys
from pathlib import PurePath

_started = PurePath(sys.argv[0]).name
if (
    (_started == "roboverse" or (_started == "-m" and "roboverse_learn" in sys.orig_argv))
    and multiprocessing.parent_process() is None
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    # Ctrl-C ends a command whose libraries are still being imported, without a traceback of one of them.
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # until cli.main

logging.getLogger("envs.gym_registration").addHandler(logging.NullHandler())  # commands say it themselves

from envs.core.machine import let_waiting_threads_sleep  # noqa: E402

let_waiting_threads_sleep()  # before torch is imported, which reads it once
