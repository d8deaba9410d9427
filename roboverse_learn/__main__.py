"""``python -m roboverse_learn``: the command line ``roboverse``."""

import sys

from roboverse_learn.cli import main

if __name__ == "__main__":
    sys.exit(main())
