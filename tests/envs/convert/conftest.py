"""A robot that has what is hard to convert, in one small file."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

HARD_ROBOT = """
<mujoco model="hard">
  <compiler angle="radian" eulerseq="zyx"/>
  <asset>
    <texture name="check" type="2d" file="check.png"/>
    <material name="checked" texture="check" rgba="1 0.5 1 1"/>
    <mesh name="wedge" file="wedge.obj" scale="2 2 2"/>
    <mesh name="stone" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1  .02 .02 .02"/>
  </asset>
  <worldbody>
    <body name="base" pos="0.1 0.2 0.3" euler="0.3 1.5707963 0.2">
      <geom type="box" size=".1 .2 .3" mass="2"/>
      <body name="two axes" pos="0 0 0.5" euler="0.1 0.2 0.3">
        <joint name="pan" axis="0 0 1" pos="0.1 0 0" range="-1 2" damping="3" armature="0.4" ref="0.3"/>
        <joint name="slide" type="slide" axis="1 1 0" range="-.1 .2" frictionloss="0.5"/>
        <joint name="tilt" axis="0 1 1" pos="0 0.05 0.1"/>
        <inertial pos="0.01 0.02 0.03" mass="1.5" fullinertia="0.03 0.04 0.05 0.001 -0.002 0.003"/>
        <geom name="look" type="mesh" mesh="wedge" material="checked" contype="0" conaffinity="0" group="1"/>
        <geom type="mesh" mesh="stone" pos=".1 0 0"/>
        <body name="finger" pos="0.1 0 0.2">
          <joint name="finger" type="slide" axis="0 0 -1" range="0 .04"/>
          <geom type="capsule" size=".01 .05" euler="0.4 0 0.1" mass=".1"/>
          <body name="tip" pos="0 0 0.1"/>
        </body>
        <body name="thumb" pos="-0.1 0 0.2">
          <joint name="thumb" axis="1 0 0" range="-1 1" ref="0.2"/>
          <geom type="ellipsoid" size=".01 .02 .03" mass=".1" rgba="1 0 0 .5" group="1"/>
        </body>
        <body name="nail" pos="-0.1 0.1 0.2">
          <joint name="nail" axis="1 0 0" range="-1 1"/>
          <geom type="cylinder" size=".01 .02" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="cord"><joint joint="thumb" coef="2"/><joint joint="nail" coef="-1"/></fixed>
  </tendon>
  <equality>
    <joint joint1="thumb" joint2="finger" polycoef="0.1 5 0 0 0"/>
    <tendon tendon1="cord"/>
  </equality>
  <actuator>
    <position name="pan" joint="pan" kp="100" kv="10" forcerange="-20 20"/>
    <motor name="finger" joint="finger" ctrlrange="-5 5" ctrllimited="true" gear="2"/>
  </actuator>
</mujoco>
"""

WEDGE = """v 0 0 0
v 0.1 0 0
v 0 0.1 0
v 0 0 0.1
vt 0 0
vt 1 0
vt 0 1
vt 0.25 0.75
f 1/1 3/3 2/2
f 1/1 2/2 4/4
f 2/2 3/3 4/4
f 3/3 1/1 4/4
"""


@pytest.fixture
def hard_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "hard.xml"
    path.write_text(HARD_ROBOT)
    (tmp_path / "wedge.obj").write_text(WEDGE)
    image = np.zeros((4, 4, 3), np.uint8)
    image[:2, :, 0], image[2:, :, 2] = 200, 100
    Image.fromarray(image).save(tmp_path / "check.png")
    return path
