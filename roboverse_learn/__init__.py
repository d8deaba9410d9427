"""Commands, configuration, data and training: everything that a user starts."""

from envs.core.machine import let_waiting_threads_sleep

let_waiting_threads_sleep()  # before torch is imported, which reads it once
