"""``roboverse view`` and the files it writes, in processes of their own.

The viewer's library starts threads when it is imported, and a process with threads of others is not safe to
fork: it stays out of the process of the tests.
"""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.imported_process import COMMAND, start

needs_viewer = pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None, reason="the extra viewer is not installed"
)

READ = """
import io, sys
from collections import defaultdict
import numpy as np
from PIL import Image
from rerun.experimental import RrdReader
rows = defaultdict(list)
for chunk in RrdReader(sys.argv[1]).store().stream():
    rows[chunk.entity_path] += chunk.to_record_batch().to_pylist()
found = {"paths": np.array(sorted(rows)), "text": np.array(rows["/draws"][0]["TextDocument:text"][0])}
images = "EncodedImage:blob"
shown = [row for row in rows["/scene/cameras/front"] if row.get(images)]
shown.sort(key=lambda row: row["time"])
found["times"] = np.array([row["time"].total_seconds() for row in shown])
found["images"] = np.stack([np.asarray(Image.open(io.BytesIO(bytes(row[images][0])))) for row in shown])
moved = [row for row in rows["/scene/cube"] if row.get("Transform3D:translation")]
moved.sort(key=lambda row: row["time"])
found["cube"] = np.array([row["Transform3D:translation"][0] for row in moved])
np.savez(sys.argv[2], **found)
"""


def view(*words: str, folder: Path, env: dict[str, str]) -> str:
    """Runs the command to its end; returns what it printed."""
    out = folder / "printed"
    process = start(COMMAND, "view", *words, folder=folder, out=out, env=env)
    process.join()
    assert process.exitcode == 0, out.read_text()
    return out.read_text()


def recorded(file: Path) -> dict[str, np.ndarray]:
    """Returns what a file holds of PickCube.

    ``paths`` of all entities, the ``text`` beside the scene, and in order of time the front
    camera's ``images``, their ``times`` in s, and the positions of the ``cube`` where it moved.
    """
    out = file.with_suffix(".npz")
    subprocess.run([sys.executable, "-W", "ignore", "-c", READ, str(file), str(out)], check=True)
    with np.load(out, allow_pickle=False) as arrays:
        return dict(arrays)
