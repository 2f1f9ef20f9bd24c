"""Who may import whom, and what must never appear: read from the source, not from hope."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(
    p
    for folder in ("", "plugins", "calibration")
    for p in (ROOT / folder).glob("clothrf_*")
    if (p / "__init__.py").exists()
)
SOURCES = sorted(f for p in PACKAGES for f in p.rglob("*.py"))
HEAVY = ("cv2", "numba", "scipy", "sklearn", "sapien", "pinocchio", "zenoh", "ruckig", "matplotlib",
         "torch", "mujoco", "distributed", "loky", "pyrealsense2")  # fmt: skip


def imported(path):
    """(module, at top level) of every import statement of a file."""
    tree = ast.parse(path.read_text())
    top = set()
    for node in tree.body:
        top |= {
            id(n) for n in ast.walk(node) if not isinstance(node, ast.FunctionDef | ast.ClassDef)
        }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, id(node) in top
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module, id(node) in top


def owner(path):
    return next(p.name for p in PACKAGES if p in path.parents)


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_plugins_know_only_the_core_and_the_core_knows_no_plugin(path):
    ours = {m.split(".")[0] for m, _ in imported(path) if m.startswith("clothrf_")}
    assert ours <= {"clothrf_core", owner(path)}


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_nothing_is_pickled(path):
    roots = {m.split(".")[0] for m, _ in imported(path)}
    assert not roots & {"pickle", "cloudpickle", "dill", "joblib", "shelve"}
    assert "allow_pickle=True" not in path.read_text()


@pytest.mark.parametrize(
    "path",
    [p / "__init__.py" for p in PACKAGES] + sorted((ROOT / "clothrf_core").glob("*.py")),
    ids=lambda p: str(p.relative_to(ROOT)),
)
def test_heavy_packages_are_imported_only_where_they_are_used(path):
    assert not {m.split(".")[0] for m, top in imported(path) if top} & set(HEAVY)


def test_listing_plugins_imports_nothing_heavy():
    code = (
        "import sys; from clothrf_core.registry import Registry; r = Registry.installed(); "
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


def test_every_package_has_one_entry_point_of_its_name():
    text = (ROOT / "pyproject.toml").read_text()
    block = re.search(r"\[project.entry-points.clothrf\]\n(.*?)\n\n", text, re.S)[1]
    points = dict(line.split(" = ") for line in block.splitlines())
    named = {value.strip('"').split(".")[0]: key for key, value in points.items()}
    assert set(named) == {p.name for p in PACKAGES}
    assert all(package == f"clothrf_{name}" for package, name in named.items())


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_stay_readable(path):
    assert len(path.read_text().splitlines()) <= 420


def test_the_top_level_is_the_agreed_one():
    result = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if result.returncode:
        pytest.skip("not a git checkout")
    top = {line.split("/")[0] for line in result.stdout.splitlines()}
    assert {t for t in top if not t.startswith(".")} == {
        "pyproject.toml", "clothrf_core", "plugins", "calibration", "tests", "configs",
        "README.md", "LICENSE",
    }  # fmt: skip
