"""One speed program in this process: ``python -m roboverse_learn.speed NAME key=value …``."""

import sys

from roboverse_learn.speed import PROGRAMS
from roboverse_learn.speed.harness import program

if __name__ == "__main__":
    sys.exit(program(sys.argv[1], PROGRAMS.get(sys.argv[1]), sys.argv[2:]))
