"""Run by test_processes.py: launches a simulator twice, tells what its processes see, and waits."""

import dataclasses
import json
import os
import sys
from pathlib import Path

from envs.core.errors import ConfigError
from envs.simulators.processes import ProcessHandler
from envs.tasks.pick_cube import PickCube


def seen(name, size):
    """A picture's source that tells instead where it is asked."""
    raise ConfigError(f"{os.environ.get('SEEN')} in {os.getcwd()},")


def main():
    scenario = PickCube().scenario
    looks = scenario.appearance
    table = dataclasses.replace(looks.materials["table"], texture="any")
    looks = dataclasses.replace(looks, materials={**looks.materials, "table": table})
    told, handlers = [], [ProcessHandler(scenario, 1, renderer="warp", textures=seen) for _ in range(2)]
    for value, folder, handler in zip(("one", "two"), sys.argv[1:], handlers, strict=True):
        os.environ["SEEN"] = value
        os.chdir(folder)
        handler.launch()
        handler.set_appearance(looks, 0)
        try:
            handler.render()
        except ConfigError as error:
            told.append(str(error))
    workers = [handler._workers[0]._process.pid for handler in handlers]
    parents = {int(Path(f"/proc/{pid}/stat").read_text().rsplit(") ")[1].split()[1]) for pid in workers}
    servers = [
        {
            "pid": pid,
            "has_imported": "libmujoco" in Path(f"/proc/{pid}/maps").read_text(),
            "threads": len(os.listdir(f"/proc/{pid}/task")),
        }
        for pid in parents
    ]
    print(json.dumps({"told": told, "workers": workers, "servers": servers}), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
