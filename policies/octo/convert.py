"""Writes a published Octo as safetensors and JSON, for ``policy=octo``; run in an environment of its own.

JAX, Flax and Orbax are needed here and nowhere else, and this package is not::

    uv venv octo && uv pip install --python octo jax[cpu] flax orbax-checkpoint safetensors huggingface_hub
    octo/bin/python policies/octo/convert.py rail-berkeley/octo-small-1.5 octo-small --tokenizer t5-base

The first argument is a folder or a hub name, the second the folder to write. Disk is checked before anything
is downloaded. A parameter keeps its path in Flax as its name; :mod:`policies.octo.flax_names` reads it.
"""

# pyright: reportMissingImports=false

import argparse
import json
import math
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.atomic import atomic_directory

PATCH_PX = 16
WEIGHTS, CONFIG = "flax.safetensors", "config.json"
_TOKENIZER = ("tokenizer.json", "tokenizer_config.json", "special_tokens_map.json")
_ROOM = 2.2
"""Free disk per size of what is downloaded: it, and what is written."""


def main(argv: list[str] | None = None) -> int:
    """Converts a checkpoint; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("source", help="folder of a published Octo, or its name on the hub")
    parser.add_argument("target", type=Path, help="folder to write")
    parser.add_argument("--tokenizer", default="t5-base", help="folder or hub name of T5's tokenizer")
    parser.add_argument("--step", type=int, help="step of the checkpoint; the last by default")
    given = parser.parse_args(argv)
    try:
        convert(given.source, given.target, given.tokenizer, given.step)
    except (OSError, ValueError, KeyError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


def convert(source: str, target: Path, tokenizer: str, step: int | None = None) -> None:
    """Converts a checkpoint.

    Args:
        source: Folder, or a name on the hub.
        target: Folder to write, which must not exist.
        tokenizer: Folder or hub name of T5's tokenizer.
        step: Step of the checkpoint; the last by default.

    Raises:
        ValueError: The folder is there, or the disk is too small.
        OSError: Something cannot be read.
    """
    from safetensors.numpy import save_file

    if target.exists():
        raise ValueError(f"'{target}' is there already. Name another folder, or remove it.")
    folder = _folder(source)
    words = _folder(tokenizer, _TOKENIZER)
    config = json.loads((folder / CONFIG).read_text(encoding="utf-8"))
    tensors = dict(flattened(read_parameters(folder, step)))
    text = json.dumps(converted_config(config, tensors), indent=1)
    with atomic_directory(target) as partial:
        save_file(tensors, partial / WEIGHTS)
        (partial / CONFIG).write_text(text, encoding="utf-8")
        for name in _TOKENIZER:
            if (words / name).is_file():
                shutil.copy(words / name, partial / name)


def read_parameters(folder: Path, step: int | None = None) -> Mapping[str, Any]:
    """Returns the tree of parameters of a checkpoint of Orbax, or of a file of Flax (``*.msgpack``).

    Raises:
        OSError: There is none.
    """
    steps = sorted(int(each.name) for each in folder.iterdir() if each.name.isdigit())
    if steps:
        import orbax.checkpoint

        chosen = folder / str(steps[-1] if step is None else step)
        inner = chosen / "default"
        path = inner if inner.is_dir() else chosen
        return orbax.checkpoint.PyTreeCheckpointer().restore(path.resolve())
    files = [path for path in folder.glob("*.msgpack") if path.name != "example_batch.msgpack"]
    if len(files) != 1:
        raise OSError(f"'{folder}' has no checkpoint: no folder named by a step, and no one *.msgpack.")
    from flax.serialization import msgpack_restore

    return msgpack_restore(files[0].read_bytes())


def flattened(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yields the path, with slashes, and the value of each parameter."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{key}/")
        else:
            yield f"{prefix}{key}", np.ascontiguousarray(value, np.float32)


def converted_config(config: Mapping[str, Any], tensors: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Returns what of the published configuration is needed, and the sizes that follow from parameters.

    Raises:
        KeyError: A parameter that says them is not there.
    """
    image_sizes = {}
    for name in config["model"]["observation_tokenizers"]:
        patches = tensors[f"octo_transformer/obs_{name}_pos_embedding"].shape[2]
        image_sizes[name] = PATCH_PX * math.isqrt(patches)
    return {
        "model_type": "octo",
        "model": config["model"],
        "window_size": config.get("window_size", 2),
        "image_sizes": image_sizes,
        "text_tokens": tensors["octo_transformer/task_language_pos_embedding"].shape[1],
    }


def _folder(source: str, only: tuple[str, ...] = ()) -> Path:
    """Returns a folder that is here, or one of the hub."""
    if Path(source).is_dir():
        return Path(source)
    from huggingface_hub import HfApi, constants, snapshot_download

    files = HfApi().model_info(source, files_metadata=True).siblings or []
    size = sum(each.size or 0 for each in files if not only or each.rfilename in only)
    cache = Path(constants.HF_HUB_CACHE)
    existing = next(each for each in (cache, *cache.absolute().parents) if each.exists())
    if (free := shutil.disk_usage(existing).free) < _ROOM * size:
        raise ValueError(
            f"'{source}' has {size / 1e9:.1f} GB, which needs {_ROOM * size / 1e9:.1f} GB of free disk, and "
            f"{existing} has {free / 1e9:.1f} GB. Nothing was downloaded."
        )
    return Path(snapshot_download(source, allow_patterns=list(only) or None))


if __name__ == "__main__":
    raise SystemExit(main())
