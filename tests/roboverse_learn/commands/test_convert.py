"""``roboverse convert``: what it prints, writes and refuses."""

import errno
from pathlib import Path

import pytest

from roboverse_learn.cli import main

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv(
        "ROBOVERSE_CACHE",
        str(tmp_path / "a folder whose name is so long that a terminal breaks it" / "cache"),
    )


def test_it_prints_the_file_that_it_wrote_on_one_line(capsys):
    assert main(["convert", "robot=franka", "simplify=true"]) == 0
    path = Path(capsys.readouterr().out.strip())
    assert path.name == "franka.urdf" and path.is_file()
    assert (path.parent / "meshes").is_dir()


def test_a_folder_can_be_chosen_and_is_not_written_over(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["convert", "robot=franka", "simplify=true", f"out={out}"]
    assert main(words) == 0
    assert (out / "franka.urdf").is_file()
    assert main(words) == 2
    assert "exists already and is not an empty folder" in capsys.readouterr().err


@pytest.mark.parametrize("to", ["urdf", "mjcf"])
def test_a_full_disk_names_the_folder_to_write_and_leaves_nothing(to, tmp_path, capsys, monkeypatch):
    def full(source, *_args, **_kwargs):
        raise OSError(errno.ENOSPC, "No space left on device", str(source))

    monkeypatch.setattr("shutil.copyfile", full)
    monkeypatch.setattr("envs.convert.urdf.write_urdf", full)
    out = tmp_path / "deep/out"
    assert main(["convert", "robot=franka", "simplify=true", f"to={to}", f"out={out}"]) == 2
    assert f"error: '{out}' could not be written: the disk is full" in capsys.readouterr().err
    assert not list(out.parent.iterdir())


URDF = """<robot name="arm">
  <link name="base"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial></link>
  <link name="tip"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="tip"/><origin xyz="0 0 0.5"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="10" velocity="3"/></joint>
</robot>"""


@pytest.mark.parametrize("words", [["{file}", "--to", "mjcf"], ["--to=mjcf", "robot={file}"]])
def test_convert_accepts_the_words_of_other_converters(words, tmp_path, capsys):
    import mujoco

    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    out = tmp_path / "mjcf"
    assert main(["convert", *(word.format(file=file) for word in words), "--out", str(out)]) == 0
    assert Path(capsys.readouterr().out.strip()) == out / "arm.xml"
    model = mujoco.MjModel.from_xml_path(str(out / "arm.xml"))
    assert model.joint("turn").range.tolist() == [-1.0, 2.0]
    assert model.body("tip").mass == 1.0 and model.body("tip").pos.tolist() == [0.0, 0.0, 0.5]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["to=udf"], "Unknown format 'udf'. Did you mean 'urdf'?"),
        (["robot=frnka"], "Unknown robot 'frnka'. Did you mean 'franka'?"),
        (["robot=absent/robot.xml"], "The asset 'absent/robot.xml' does not exist"),
        (["frnka", "--to", "usd"], "Unknown robot 'frnka'. Did you mean 'franka'?"),
        (["robt=franka"], "Unknown key 'robt' of convert. Did you mean 'robot'?"),
    ],
)
def test_mistakes_are_one_sentence_and_exit_code_2(words, said, capsys):
    assert main(["convert", *words]) == 2
    assert said in capsys.readouterr().err


def test_what_a_format_cannot_say_is_a_warning(caplog):
    assert main(["convert", "robot=robosuite:models/assets/robots/jaco/robot.xml"]) == 0
    assert "Material 'carbon_jaco' has a cube map" in caplog.text
