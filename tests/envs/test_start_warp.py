"""Warp says nothing where it has nothing to say."""

import os
import subprocess
import sys

import pytest

from envs import start_warp


@pytest.mark.slow
def test_rendering_prints_nothing():
    code = (
        "from envs.spec import EnvSpec\n"
        "env = EnvSpec(task='PickCube', image_size=16).make(1)\n"
        "observation, _ = env.reset(seed=0)\n"
        "assert observation['pixels']['front'].shape == (1, 16, 16, 3)\n"
        "from envs.start_warp import start_warp\n"
        "start_warp()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_other_lines_of_the_standard_error_stay(capfd):
    with start_warp._stderr_without(b"CUDA"):
        os.write(2, b"Warp CUDA warning: none\nan error\n")
    os.write(2, b"CUDA after it\n")
    assert capfd.readouterr().err == "an error\nCUDA after it\n"


def test_a_driver_without_a_device_is_no_error_and_others_are(monkeypatch, capfd):
    none = (
        b"Warp CUDA error 100: no CUDA-capable device is detected (in function init_cuda_driver, util:333)\n"
    )
    monkeypatch.setattr("warp.init", lambda: os.write(2, none + b"Warp CUDA error 999: unknown error\n"))
    start_warp.start_warp.__wrapped__()
    assert capfd.readouterr().err == "Warp CUDA error 999: unknown error\n"
