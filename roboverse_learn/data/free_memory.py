"""Memory that this process may still use, on every operating system."""

from pathlib import Path

import psutil


def free_memory_bytes() -> int:
    """Returns the memory that can still be used, within the container's limit if there is one."""
    free = psutil.virtual_memory().available
    limit, used = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")
    if limit.exists() and used.exists() and (text := limit.read_text().strip()) != "max":
        free = min(free, int(text) - int(used.read_text()))
    return max(free, 0)
