"""Launchers: where the processes of a sweep run, the values of ``launcher=``.

A launcher is a :class:`~roboverse_learn.launch.base.Launcher` and a line here, or an entry point in the group
``roboverse.launchers`` of another package.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from envs.core.registry import Registry
from envs.scenario.typed_settings import typed_settings

if TYPE_CHECKING:
    from roboverse_learn.launch.base import Launcher

LAUNCHERS: "Registry[type[Launcher]]" = Registry("launcher", "roboverse.launchers")
LAUNCHERS.add(
    "local", "roboverse_learn.launch.local:LocalLauncher", summary="processes that share this machine's GPUs"
)
LAUNCHERS.add(
    "slurm", "roboverse_learn.launch.slurm:SlurmLauncher", summary="a batch job of Slurm for each process"
)


def make_launcher(name: str, settings: Mapping[str, Any], jobs_per_gpu: int = 1) -> "Launcher":
    """Returns a launcher with its settings, which are checked; nothing is started.

    Args:
        name: Registered name.
        settings: Its settings as plain values, by name.
        jobs_per_gpu: Processes that share a GPU.

    Raises:
        UnknownNameError: if there is no such launcher or setting.
        ConfigError: if a setting has an invalid value, or the launcher cannot share GPUs.
    """
    launcher = LAUNCHERS.get(name)
    typed = typed_settings(launcher.settings_class, settings, "launcher_settings", f"launcher={name}")
    return launcher(typed, jobs_per_gpu)
