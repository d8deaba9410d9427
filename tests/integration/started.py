"""Run in a process that has imported everything: one of our scripts as it is, as if it had been started."""

import os
import runpy
import sys
from typing import Any

given: dict[str, Any] = globals()["start"]
"""From outside: ``words`` of the command line, the ``folder`` it runs in, and the ``log`` it prints to."""

os.chdir(given["folder"])
output = os.open(given["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
for stream in (1, 2):
    os.dup2(output, stream)
sys.argv = given["words"]
runpy.run_path(given["words"][0], run_name="__main__")
