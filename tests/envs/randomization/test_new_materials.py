import numpy as np
import pytest

from envs.randomization import load_split
from envs.randomization.materials import MaterialLibrary
from envs.randomization.new_materials import main, new_names
from envs.randomization.procedural import FAMILIES, parse
from envs.scenario import SURFACES


def test_new_materials_are_of_every_family_and_of_no_split():
    new = [name for surface in range(len(SURFACES)) for name in new_names(surface)]
    assert len(set(new)) == len(new)
    assert {parse(name)[0].name for name in new} == set(FAMILIES)
    for split in ("train", "test"):
        assert not set(new) & {name for names in load_split(split).materials.values() for name in names}


@pytest.mark.slow
def test_their_folder_replaces_the_built_in_materials(tmp_path, caplog):
    assert main([f"out={tmp_path}"]) == 0
    library = MaterialLibrary.from_folder(tmp_path)
    for surface, name in enumerate(SURFACES):
        assert list(library.names[name]) == sorted(f"{name}/{each}.png" for each in new_names(surface))
    first = library.texture(library.names["table"][0])
    assert first.shape[-1] == 3 and np.ptp(first) > 10
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.png")}
    assert main([f"out={tmp_path}"]) == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.png")} == before
