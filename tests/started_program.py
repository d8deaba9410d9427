"""Run in a process of ``imported_process.py``: one program, as if an interpreter had been started for it."""

import logging
import os
import runpy
import sys
from typing import Any

given: dict[str, Any] = globals()["start"]
"""From outside, see ``imported_process.start``."""

os.chdir(given["folder"])
os.environ.clear()
os.environ.update(given["env"])
for stream, path in enumerate((given["out"], given["err"] or given["out"]), start=1):
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_TRUNC)
    os.dup2(file, stream)
    os.close(file)
logging.root.handlers.clear()  # LeRobot's import leaves one, and a program sets its own
sys.path[:0] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
if os.path.isfile(given["program"]):
    sys.argv = [str(given["program"]), *given["words"]]
    runpy.run_path(str(given["program"]), run_name="__main__")
else:
    sys.argv = ["-c", *given["words"]]
    exec(compile(given["program"], "<string>", "exec"), {"__name__": "__main__"})
