"""Lets ``gymnasium.make("RoboVerse/PickCube-v0")`` work without an import of our packages.

Python imports this module at its start, by ``roboverse_gymnasium.pth``. It waits for Gymnasium's import, and
then ``make``, ``make_vec`` and ``spec`` import ``envs`` when they are first given an id of our namespace.
"""

import sys

NAMESPACE = "RoboVerse/"
REGISTRATION = "gymnasium.envs.registration"


def register_tasks():
    """Imports ``envs``, which registers every task; once it is imported, nothing happens.

    Raises:
        ImportError: It is not installed, or a package of the same name hides it.
    """
    import importlib

    if "envs.gym_registration" not in sys.modules:
        _check_not_hidden()
        importlib.import_module("envs")


def _check_not_hidden():
    import importlib.util
    from pathlib import Path

    found = importlib.util.find_spec("envs")
    folders = [Path(folder) for folder in (found and found.submodule_search_locations) or ()]
    if any((folder / "gym_registration.py").is_file() for folder in folders):
        return
    if found is None or (found.origin is None and not folders):
        raise ImportError(
            "RoboVerse Learn is not installed in this environment, so Gymnasium has none of the ids "
            f"{NAMESPACE}…. Install roboverse-learn."
        )
    raise ImportError(
        f"{found.origin or folders[0]} hides the package envs of RoboVerse Learn, so Gymnasium has none of "
        f"the ids {NAMESPACE}…. Rename it, or run the program from another folder."
    )


def _knows_tasks(function):
    """Returns a function of Gymnasium whose first argument is an id, with our ids among those it knows."""
    import functools

    @functools.wraps(function)
    def wrapper(*args, **kwargs):
        for name in (*args[:1], kwargs.get("id"), kwargs.get("env_id")):
            if isinstance(name, str) and name.startswith(NAMESPACE):
                register_tasks()
        return function(*args, **kwargs)

    return wrapper


class _Finder:
    """Finds one module, Gymnasium's registration, and wraps its functions as soon as they are there."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Returns None for every other module."""
        if name != REGISTRATION:
            return None
        import importlib.util

        sys.meta_path.remove(_Finder)
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            for function in ("make", "make_vec", "spec"):
                setattr(module, function, _knows_tasks(getattr(module, function)))

        spec.loader.exec_module = exec_module
        return spec


if REGISTRATION not in sys.modules:
    sys.meta_path.insert(0, _Finder)
