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
MAX_FILE_LINES, MAX_HANDLER_LINES, MAX_FUNCTION_LINES = 400, 500, 70
MIN_TEST_SHARE = 0.35
PICKLES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
PICKLE_CALLS = {
    ("torch", "save"),
    ("torch", "load"),
    ("np", "load"),
    ("numpy", "load"),
    ("pd", "read_pickle"),
}
PRINTS_MAY_BE_IN = {"roboverse_learn/cli.py"}


def sources(folder: str) -> list[Path]:
    return sorted(path for path in (ROOT / folder).rglob("*.py") if "__pycache__" not in path.parts)


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
                    told = str(error).splitlines()[0]
                    broken.append(told if name(path) in told else f"{name(path)}: {told}")
            assert not broken, "\n".join(broken)

        return test

    return decorate


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> set[str]:
    """Every module that a file imports, inside functions too, and by name through ``import_module``."""
    found = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)}:{node.lineno}: write absolute imports."
            found.add(node.module or "")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            reference = re.fullmatch(r"([a-z_]+(?:\.[a-z_0-9]+)+)(?::\w+)?", node.value)
            if reference and reference[1].partition(".")[0] in PACKAGES and _is_module(reference[1]):
                found.add(reference[1])
    return found


def _is_module(dotted: str) -> bool:
    path = ROOT.joinpath(*dotted.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


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


def test_nothing_imports_the_tests() -> None:
    assert not [name(path) for path in SOURCES if any(m.split(".")[0] == "tests" for m in imports(path))]


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
    needed = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    names = {re.split(r"[\[<>=!~ ;]", item)[0].lower().replace("_", "-") for item in needed}
    assert names <= pins, f"not pinned: {sorted(names - pins)}"


def test_the_hooks_have_their_program() -> None:
    assert (ROOT / ".pre-commit-config.yaml").is_file()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert any(item.startswith("pre-commit>=") for item in project["optional-dependencies"]["dev"])


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
