"""The rules of the code base that a reviewer cannot be expected to check: direction, sizes, no pickle."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("envs", "policies", "benchmark", "roboverse_learn")
MAY_IMPORT = {
    "envs": {"envs"},
    "policies": {"policies"},
    "benchmark": {"benchmark", "envs", "policies"},
    "roboverse_learn": set(PACKAGES),
}
LAYERS = (
    ("core",),
    (
        "array_ops",
        "rotations",
        "scenario",
        "state",
        "robots",
        "randomization",
        "compat",
        "joint_readings",
        "start_warp",
    ),
    ("mjcf",),
    ("kinematics", "convert"),
    ("simulators",),
    ("controllers", "hand_pose_controller", "hand_target_controller", "operational_space"),
    ("tasks",),
    (
        "episode_hash",
        "lazy_images",
        "start_states",
        "step_checks",
        "batched_env",
        "vector_env",
        "torch_env",
        "pixel_env",
        "multi_task_env",
    ),
    ("spec",),
    ("episode", "rollout", "playback"),
    ("experts", "adapters", "lerobot", "gym_env", "gym_registration"),
    ("",),
)
"""Folders and modules of ``envs``, the lowest first; each imports its own layer and those below it."""

MAX_FILE_LINES, MAX_HANDLER_LINES, MAX_FUNCTION_LINES = 400, 500, 70
MIN_TEST_SHARE = 0.35
PICKLES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
PICKLE_CALLS = {(m, "load") for m in ("torch", "np", "numpy")} | {("torch", "save"), ("pd", "read_pickle")}
PRINTS_MAY_BE_IN = {"roboverse_learn/cli.py"}


def sources(folder: str) -> list[Path]:
    # The plugins of LeRobot and Gymnasium are distributions of their own, above all packages.
    others = {"__pycache__", "plugin", "gymnasium_plugin"}
    return sorted(path for path in (ROOT / folder).rglob("*.py") if not others & {*path.parts})


SOURCES = [path for package in PACKAGES for path in sources(package)]
ALL = [*SOURCES, *sources("tests")]


@pytest.fixture(scope="module", autouse=True)
def _forgotten():
    """A million nodes of syntax trees stay no longer than they are of use."""
    yield
    tree.cache_clear()


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def holds_of(paths: list[Path]) -> Callable[[Callable[[Path], None]], Callable[[], None]]:
    """Makes one test of a rule for files: it names all that break it. A thousand tests would take longer."""

    def decorate(rule: Callable[[Path], None]) -> Callable[[], None]:
        def test() -> None:
            broken = []
            for path in paths:
                try:
                    rule(path)
                except AssertionError as error:
                    message = str(error).splitlines()[0]
                    broken.append(message if name(path) in message else f"{name(path)}: {message}")
            assert not broken, "\n".join(broken)

        return test

    return decorate


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> set[str]:
    """Every module that a file imports, inside functions too, and those that it names as strings."""
    return {module for module, _ in references(path)}


@cache
def references(path: Path) -> set[tuple[str, str]]:
    """Returns (module, kind) of a file's imports; kind is ``import``, ``program`` or ``string``.

    ``program`` is an import below ``if __name__ == "__main__"``, which an import of the file does not run.
    """
    found = set()
    programs = {inner for node in tree(path).body if _is_program(node) for inner in ast.walk(node)}
    for node in ast.walk(tree(path)):
        kind = "program" if node in programs else "import"
        if isinstance(node, ast.Import):
            found |= {(alias.name, kind) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)}:{node.lineno}: write absolute imports."
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add((inner if is_module(inner) else str(node.module), kind))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            reference = re.fullmatch(r"([a-z_]+(?:\.[a-z_0-9]+)+)(?::\w+)?", node.value)
            if reference and reference[1].partition(".")[0] in PACKAGES and is_module(reference[1]):
                found.add((reference[1], "string" if ":" in node.value else "text"))
    return found


def _is_program(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "__name__ == '__main__'"


@cache
def is_module(dotted: str) -> bool:
    path = ROOT.joinpath(*dotted.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def module_graph() -> dict[str, set[str]]:
    """Module to the modules of ours that it imports, in functions too.

    A registry's ``"module:Class"`` counts too, but for modules in the registry's own folder.
    """
    graph: dict[str, set[str]] = {}
    for path in SOURCES:
        own, folder = module_name(path), module_name(path.parent / "__init__.py")
        graph[own] = {
            module
            for module, kind in references(path)
            if module != own and is_module(module) and module.partition(".")[0] in PACKAGES
            if kind == "import" or (kind == "string" and not module.startswith(f"{folder}."))
        }
    return graph


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Returns the groups of nodes that reach one another (Tarjan's strongly connected components)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in order:
                visit(other)
            if other in stack:
                low[node] = min(low[node], low[other])
        if low[node] == order[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in graph:
        if node not in order:
            visit(node)
    return found


@pytest.mark.slow
@holds_of(SOURCES)
def test_imports_point_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    core = {module for module in imports(path) if module.startswith("envs.core")}  # errors, registry, files
    seen = imports(path) - core if package == "policies" else imports(path)
    ours = {module.partition(".")[0] for module in seen} & set(PACKAGES)
    allowed = MAY_IMPORT[package]
    if name(path) == "roboverse_learn/training/config.py":
        allowed = allowed - {"policies"}  # read by --help, before anything is chosen
    assert ours <= allowed, f"{name(path)} imports {sorted(ours - allowed)}; {package} may not."


def _folder(module: str) -> str:
    """Returns which entry of :data:`LAYERS` a module of ``envs`` is in."""
    return module.split(".")[1] if "." in module else ""


def test_folders_of_envs_import_lower_layers_alone() -> None:
    level = {folder: index for index, layer in enumerate(LAYERS) for folder in layer}
    broken, folders = [], {folder: set() for folder in level}
    for own, imported in module_graph().items():
        if own.partition(".")[0] != "envs":
            continue
        assert _folder(own) in level, f"{own} is in no layer. Add its folder to LAYERS."
        for other in imported:
            folders[_folder(own)] |= {_folder(other)} - {_folder(own)}
            if level[_folder(other)] > level[_folder(own)]:
                broken.append(f"{own} imports {other}, which is in a higher layer.")
    assert not broken, "\n".join(broken)
    assert not circles(folders)


def test_no_modules_import_one_another_in_a_circle() -> None:
    graph = module_graph()
    found = circles(graph)
    assert not found, "\n".join(
        f"{own} imports {sorted(graph[own] & {*group})}" for group in found for own in group
    )


@holds_of([path for path in SOURCES if "simulators" not in path.relative_to(ROOT).parts])
def test_private_attributes_of_a_handler_are_its_own(path: Path) -> None:
    found = re.findall(r"handler\._[a-z]\w+", path.read_text(encoding="utf-8"))
    assert not found, f"{name(path)} uses {found}."


def test_core_imports_the_standard_library_alone() -> None:
    for path in sources("envs/core"):
        for module in imports(path):
            top = module.partition(".")[0]
            allowed = top in sys.stdlib_module_names or module.startswith("envs.core")
            assert allowed, f"{name(path)} imports {module}."


def test_nothing_imports_the_tests() -> None:
    assert not [name(path) for path in SOURCES if any(m.split(".")[0] == "tests" for m in imports(path))]


@pytest.mark.slow
@holds_of(ALL)
def test_files_and_functions_are_short(path: Path) -> None:
    limit = MAX_HANDLER_LINES if "simulators" in path.parts else MAX_FILE_LINES
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= limit, f"{name(path)} has {lines} lines; the cap is {limit}. Divide it."
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            assert length <= MAX_FUNCTION_LINES, (
                f"{name(path)}:{node.lineno}: {node.name} has {length} lines, {MAX_FUNCTION_LINES} at most."
            )


def test_a_third_of_the_code_is_tests() -> None:
    def lines(paths: list[Path]) -> int:
        return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)

    share = lines(sources("tests")) / lines(ALL)
    assert share >= MIN_TEST_SHARE, f"Tests are {100 * share:.0f} % of the lines of Python."


@pytest.mark.slow
@holds_of(SOURCES)
def test_nothing_pickles(path: Path) -> None:
    if name(path) == "roboverse_learn/data/importers/restricted_unpickler.py":
        return  # reads foreign pickles by an allow-list
    assert not {module.partition(".")[0] for module in imports(path)} & PICKLES
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            assert isinstance(node.value, ast.Constant) and node.value.value is False
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        owner = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
        refused = (owner, node.func.attr) in PICKLE_CALLS - {("np", "load"), ("numpy", "load")}
        assert not refused, f"{name(path)}:{node.lineno}: {owner}.{node.func.attr} reads or writes pickles."


@holds_of(SOURCES)
def test_prints_are_in_the_command_line_alone(path: Path) -> None:
    calls = [
        node.lineno
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]
    assert not calls or name(path) in PRINTS_MAY_BE_IN, f"{name(path)}:{calls}: log, or return what to print."


@pytest.mark.slow
@holds_of(SOURCES)
def test_the_compiler_is_given_the_options_that_keep_gradients_right(path: Path) -> None:
    for node in ast.walk(tree(path)):
        if not isinstance(node, ast.Call):
            continue
        given = {keyword.arg: keyword.value for keyword in node.keywords}
        called = isinstance(node.func, ast.Attribute) and node.func.attr == "compile"
        if "fullgraph" in given or (called and ast.unparse(node.func) == "torch.compile"):
            where = f"{name(path)}:{node.lineno}"
            options = ast.unparse(given["options"]) if "options" in given else ""
            assert re.search("(INDUCTOR|OBJECTIVE)_OPTIONS", options), f"{where}: see policies/compilation.py"


@pytest.mark.slow
@holds_of(ALL)
def test_no_bare_except_no_blanket_ignore_no_loose_end(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(tree(path)):
        assert not (isinstance(node, ast.ExceptHandler) and node.type is None), f"{name(path)}: bare except"
    assert not re.search(r"filterwarnings\(\s*[\"']ignore[\"']\s*\)", text), f"{name(path)}: blanket ignore"
    marks = "|".join(("TO" + "DO", "FIX" + "ME"))
    assert not re.search(rf"\b({marks})\b", text), f"{name(path)} has a loose end."


@holds_of(ALL)
def test_names_say_something(path: Path) -> None:
    assert path.stem not in {"utils", "util", "helpers", "helper", "misc", "common"}
    assert not re.search(r"_v\d+$", path.stem)


def test_every_package_is_in_the_wheel() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert sorted(wheel["packages"]) == sorted(PACKAGES)
    assert wheel["force-include"]["configs"] == "roboverse_learn/configs"


def readme_commands() -> list[str]:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line.startswith("python3.12 -m venv ")]


def test_the_readme_has_its_two_commands() -> None:
    main, tests = readme_commands()
    assert main.endswith("roboverse_learn/train.py policy=act task=PickCube preset=quick")
    assert re.search(r"-m pytest\S*( |$)", tests)
    for command in (main, tests):
        assert "-c constraints.txt --override overrides.txt" in command
        assert (ROOT / "constraints.txt").is_file() and (ROOT / "overrides.txt").is_file()


def test_what_the_readme_shows_exists() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        if not target.startswith(("http://", "https://")):
            assert (ROOT / target).exists(), f"README.md links to {target}, which does not exist."
    for script in re.findall(r"roboverse_learn/\w+\.py", text):
        assert (ROOT / script).is_file()


def test_constraints_pin_every_requirement_and_name_no_host() -> None:
    text = (ROOT / "constraints.txt").read_text()
    assert "://" not in text and "#" not in text
    pins = {line.partition("==")[0].lower().replace("_", "-") for line in text.split()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *extras["dev"], *extras["docs"]]
    names = {re.split(r"[\[<>=!~ ;]", item)[0].lower().replace("_", "-") for item in needed}
    assert names <= pins, f"not pinned: {sorted(names - pins)}"


def test_the_hooks_have_their_program() -> None:
    assert (ROOT / ".pre-commit-config.yaml").is_file()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert any(item.startswith("pre-commit>=") for item in project["optional-dependencies"]["dev"])


@pytest.mark.slow
@pytest.mark.parametrize("script", ["train", "collect", "evaluate", "leaderboard", "replay", "conservation"])
def test_a_script_hides_no_other_package(script: str) -> None:
    # Python puts the script's folder first on sys.path, where `data`, `run` and `config` would be found.
    code = (
        f"import runpy, sys; sys.path[0] = r'{ROOT / 'roboverse_learn'}'\n"
        f"sys.argv = ['{script}.py', '--help']\n"
        f"try: runpy.run_path(r'{ROOT / 'roboverse_learn' / script}.py', run_name='__main__')\n"
        f"except SystemExit as end: assert end.code == 0, end.code\n"
        f"assert r'{ROOT / 'roboverse_learn'}' not in sys.path, sys.path"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert f"roboverse {script}" in done.stdout
