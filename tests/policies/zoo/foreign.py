"""A checkpoint of another program, and what evaluation and training find of it before it is loaded."""

import json
from pathlib import Path

from roboverse_learn.config.compose import compose


def write(folder: Path, **values) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(json.dumps(values))
    return folder


def image(size: int) -> dict:
    return {"type": "VISUAL", "shape": [3, size, size]}


def smolvla_base(folder: Path) -> Path:
    """A SmolVLA of another program; its weights are not read before the cameras are."""
    features = {"observation.images.camera1": image(256), "observation.images.camera2": image(256),
                "observation.state": {"type": "STATE", "shape": [6]}}  # fmt: skip
    output = {"action": {"type": "ACTION", "shape": [6]}}
    values = {"input_features": features, "output_features": output, "max_state_dim": 32}
    folder = write(folder, type="smolvla", **values)
    (folder / "model.safetensors").write_bytes(b"weights")
    return folder


def evaluate(checkpoint_folder: Path, *words: str):
    from roboverse_learn.commands.tested_checkpoint import checkpoint_to_test

    return checkpoint_to_test(compose("evaluate", [f"checkpoint={checkpoint_folder}", *words]))


def check(*words: str) -> None:
    """What training finds before demonstrations are collected."""
    from roboverse_learn.training.learners import learner_of

    learner_of(compose("train", ["policy=lerobot", "task=PickCube", *words]), "cpu").check()
