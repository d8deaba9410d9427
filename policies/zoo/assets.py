"""What a checkpoint carries beside its weights: tokenizers and the configuration of its backbone.

LeRobot saves the *names* of both, which it looks up again at each load. A checkpoint of ours has copies,
under
``assets/``, and ``assets.json`` maps each name to its copy. ``config.json`` keeps the names, so that
LeRobot's own
programs read the folder as any other.
"""

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from envs.core.errors import PolicyError
from policies import checkpoint

FOLDER, INDEX = "assets", "assets.json"

BACKBONES: Mapping[str, tuple[str, ...]] = {
    "smolvla": ("vlm_model_name",),
    "multi_task_dit": ("vision_encoder_name", "text_encoder_name"),
    "eo1": ("vlm_base",),
    "vla_jepa": ("qwen_model_name", "jepa_encoder_name"),
    "pi0_fast": ("text_tokenizer_name", "action_tokenizer_name"),
}
"""Settings that name a backbone whose weights a checkpoint has: it is built again from its configuration."""

_CLIP = "lerobot.policies.multi_task_dit.modeling_multi_task_dit"
_JEPA = "lerobot.policies.vla_jepa"
_WEIGHTLESS: Mapping[str, tuple[tuple[str, str], ...]] = {
    "multi_task_dit": ((_CLIP, "CLIPVisionModel"), (_CLIP, "CLIPTextModel")),
    "vla_jepa": (
        (f"{_JEPA}.qwen_interface", "Qwen3VLForConditionalGeneration"),
        (f"{_JEPA}.modeling_vla_jepa", "AutoModel"),
    ),
}
"""Classes that a type reads with their weights, as module and name."""

_SMALL = 64 * 2**20
_NO_WEIGHTS = (".json", ".txt", ".model", ".jinja", ".py")


def read_assets(directory: Path) -> dict[str, str]:
    """Returns the absolute folder of each name that a checkpoint carries; none for one of another program.

    Raises:
        PolicyError: if such a folder is missing.
    """
    if not (directory / INDEX).is_file():
        return {}
    entries = checkpoint.read_json(directory / INDEX)
    if missing := [str(copy) for copy in entries.values() if not (directory / str(copy)).is_dir()]:
        raise PolicyError(
            f"Checkpoint '{directory}' has no {' and no '.join(missing)}, which its {INDEX} names: the "
            f"tokenizer or the configuration of a backbone. Copy the checkpoint again, with its {FOLDER}."
        )
    return {name: str((directory / str(copy)).resolve()) for name, copy in entries.items()}


def write_assets(
    directory: Path, type_name: str, config: Any, preprocessor: Any, known: Mapping[str, str]
) -> None:
    """Copies tokenizers and backbone configurations into a checkpoint.

    Args:
        directory: The checkpoint, under way.
        type_name: LeRobot's policy type.
        config: LeRobot's configuration.
        preprocessor: Its pipeline, whose steps hold the tokenizers.
        known: Folders of names that were read from other ones, as :func:`read_assets` gives them.
    """
    index: dict[str, str] = {}
    for step in preprocessor.steps:
        for attribute in ("input_tokenizer", "action_tokenizer"):
            tokenizer: Any = getattr(step, attribute, None)
            name = getattr(
                step, "tokenizer_name" if attribute == "input_tokenizer" else "action_tokenizer_name", None
            )
            if name and hasattr(tokenizer, "save_pretrained"):
                original = next((each for each, folder in known.items() if folder == name), name)
                tokenizer.save_pretrained(directory / _place(index, original))
    for key in BACKBONES.get(type_name, ()):
        name = str(getattr(config, key))
        source = Path(known.get(name) or _source(name))
        target = directory / _place(index, name)
        target.mkdir(parents=True, exist_ok=True)
        for path in source.iterdir():
            if path.is_file() and path.suffix in _NO_WEIGHTS and path.stat().st_size < _SMALL:
                shutil.copyfile(path, target / path.name)
    if index:
        (directory / INDEX).write_text(json.dumps(index, indent=2), encoding="utf-8")


def _place(index: dict[str, str], name: str) -> str:
    """Returns the folder of a name inside a checkpoint; its last part stays, as LeRobot looks at it."""
    if name not in index:
        base = Path(name).name or "backbone"
        taken = set(index.values())
        numbers = ["", *(f"_{number}" for number in range(2, len(taken) + 3))]
        index[name] = next(place for n in numbers if (place := f"{FOLDER}/{base}{n}") not in taken)
    return index[name]


def _source(name: str) -> str:
    """Returns the folder of a backbone, which is here because it was just built from it."""
    if Path(name).is_dir():
        return name
    from huggingface_hub import snapshot_download

    return snapshot_download(
        name, allow_patterns=[f"*{suffix}" for suffix in _NO_WEIGHTS], local_files_only=True
    )


@contextmanager
def carried(config: Any, assets: Mapping[str, str], *, weights: bool) -> Iterator[None]:
    """While a model is built, its backbone is read from carried folders.

    Args:
        config: LeRobot's configuration, changed within and restored after it.
        assets: Folder by name.
        weights: Whether the backbone's own weights are wanted, as for training from the start; otherwise it
            is
            built from its configuration alone, and a checkpoint's weights follow.
    """
    before: dict[str, Any] = {}

    def change(key: str, value: Any) -> None:
        before[key] = getattr(config, key)
        setattr(config, key, value)

    for key in BACKBONES.get(config.type, ()):
        if (name := str(getattr(config, key))) in assets:
            change(key, assets[name])
    with ExitStack() as stack:
        if not weights:
            if hasattr(config, "load_vlm_weights"):
                change("load_vlm_weights", False)
            if config.type == "eo1":
                change("pretrained_path", Path(config.vlm_base))  # what it asks before it reads weights
            for module, name in _WEIGHTLESS.get(config.type, ()):
                stack.enter_context(_weightless(module, name))
        try:
            yield
        finally:
            for key, value in before.items():
                setattr(config, key, value)


@contextmanager
def _weightless(module_name: str, class_name: str) -> Iterator[None]:
    """Replaces a class of transformers in one module by one whose ``from_pretrained`` reads no weights."""
    import importlib

    from transformers import AutoConfig

    module = importlib.import_module(module_name)
    original = getattr(module, class_name)

    class FromConfig(original):
        @classmethod
        def from_pretrained(cls, name: str, **_: Any) -> Any:
            if hasattr(original, "config_class"):
                return original(original.config_class.from_pretrained(name))
            return original.from_config(AutoConfig.from_pretrained(name))

    setattr(module, class_name, FromConfig)
    try:
        yield
    finally:
        setattr(module, class_name, original)


@contextmanager
def tokenizer_from(config: Any, folder: str) -> Iterator[None]:
    """While processors are made, every tokenizer is read from a folder; an empty one changes nothing.

    π0 names its tokenizer in its code alone, so that no setting reaches it.
    """
    import importlib

    module = importlib.import_module(type(config).__module__.replace("configuration_", "processor_"))
    original = getattr(module, "TokenizerProcessorStep", None)
    if not folder or original is None:
        yield
        return

    def from_folder(*args: Any, tokenizer_name: str, **kwargs: Any) -> Any:
        del tokenizer_name
        return original(*args, tokenizer_name=folder, **kwargs)

    module.TokenizerProcessorStep = from_folder  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        module.TokenizerProcessorStep = original  # pyright: ignore[reportAttributeAccessIssue]
