"""Makes ManiSkill build its scenes on a machine where SAPIEN finds no renderer."""

from typing import Any

import sapien.render  # pyright: ignore[reportMissingImports]
import sapien.wrapper.urdf_loader  # pyright: ignore[reportMissingImports]


class _Unseen:
    """Stands for materials where SAPIEN finds no renderer."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *_, **__: None


def without_materials() -> None:
    """Replaces the materials that need a renderer, in this process."""
    for module in (sapien.render, sapien.pysapien.render, sapien.wrapper.urdf_loader):
        for name in ("RenderMaterial", "RenderTexture2D"):
            setattr(module, name, _Unseen)
