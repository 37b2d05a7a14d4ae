"""Code outside a room imports its public names only: no part of a path begins with `_`, names are exported.

Tests, benchmarks, experiments, examples and the Python blocks of the docs are outside all rooms; a room is
outside the others.
"""

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = "sfgs_jax"
ROOMS = (
    "arrays",
    "datasets",
    "factor_graph",
    "geometry",
    "gicp",
    "sensors",
    "slam",
    "splatting",
    "superfeats",
)
SE3 = "sfgs_jax.geometry.se3"


def files() -> list[str]:
    """All files that the rule holds for, relative to the root."""
    folders = (LIBRARY, "tests", "benchmarks", "experiments", "examples")
    sources = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    return sorted(path.relative_to(ROOT).as_posix() for path in (*sources, *pages))


def source_of(path: Path) -> str:
    """Python source of a file; of a page its Python blocks."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text
    blocks = re.findall(r"^ *```python\n.*?```", text, re.DOTALL | re.MULTILINE)
    return "\n".join(textwrap.dedent(block).strip("`").removeprefix("python") for block in blocks)


@cache
def exports(module: str) -> frozenset[str] | None:
    """Names that a module of the library offers; None if there is no such module.

    A package offers its public submodules and what its `__init__` imports as itself or assigns; a module
    offers all that it defines or imports. Names with a leading underscore are private, `__version__` is not.
    """
    path = ROOT.joinpath(*module.split("."))
    package = path.is_dir()
    file = path / "__init__.py" if package else path.with_suffix(".py")
    if not file.exists():
        return None
    names = {p.stem for p in path.iterdir() if p.is_dir() or p.suffix == ".py"} if package else set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            again = [a for a in node.names if not package or a.asname == a.name]
            names |= {a.asname or a.name for a in again}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {t.id for t in targets if isinstance(t, ast.Name)}
    return frozenset(name for name in names if name == "__version__" or not name.startswith("_"))


def is_public(dotted: str) -> bool:
    """True if each part of a dotted name is offered by the part before it."""
    module, *rest = dotted.split(".")
    for name in rest:
        offered = exports(module)
        if offered is None:
            return True  # attributes of a class, say
        if name not in offered:
            return False
        module = f"{module}.{name}"
    return True


def used_names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and dotted name of every use of the library: imports, attributes of what was imported, strings."""
    known: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and not node.level and inside(node.module or ""):
            for alias in node.names:
                known[alias.asname or alias.name] = f"{node.module}.{alias.name}"
                yield node.lineno, f"{node.module}.{alias.name}"
        elif isinstance(node, ast.Import):
            for alias in filter(lambda a: inside(a.name), node.names):
                known[alias.asname or LIBRARY] = alias.name if alias.asname else LIBRARY
                yield node.lineno, alias.name
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            parts, base = [node.attr], node.value
            while isinstance(base, ast.Attribute):
                parts, base = [base.attr, *parts], base.value
            if isinstance(base, ast.Name) and base.id in known:
                yield node.lineno, ".".join([known[base.id], *parts])
        elif isinstance(node, ast.Constant) and re.fullmatch(rf"{LIBRARY}(\.\w+)+", str(node.value)):
            yield node.lineno, str(node.value)  # for monkeypatching, say


def inside(module: str) -> bool:
    return module.split(".")[0] == LIBRARY


def violations(path: str, source: str) -> list[str]:
    """Uses of the library that are not public, as `path:line: name`."""
    room = path.split("/")[1].removesuffix(".py") if path.startswith(f"{LIBRARY}/") else None
    if room == "__init__":
        return []
    found = {
        f"{path}:{line}: {name}"
        for line, name in used_names(ast.parse(source))
        if name.split(".")[1:2] != [room] and not is_public(name)
    }
    return sorted(found)


@pytest.mark.parametrize("path", files())
def test_only_public_names_are_used(path):
    found = violations(path, source_of(ROOT / path))
    assert not found, "not public:\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("line", "allowed"),
    [
        ("import sfgs_jax; sfgs_jax.gicp.align", True),
        ("from sfgs_jax.geometry import Camera, se3; se3.exp; Camera.project", True),
        ("from sfgs_jax.geometry.se3 import exp", True),
        ("import sfgs_jax.geometry.se3 as m; m.exp", True),
        ("from sfgs_jax import __version__", True),
        ("from sfgs_jax.geometry._camera import Camera", False),
        ("import sfgs_jax.geometry._camera", False),
        ("from sfgs_jax.geometry import _camera", False),
        ("from sfgs_jax.geometry.se3 import _promoting", False),
        ("from sfgs_jax import geometry; geometry._camera.Camera", False),
        ("from sfgs_jax.geometry import clean_images", False),
        ("monkeypatch.setattr('sfgs_jax.geometry._camera.Camera', None)", False),
    ],
)
def test_the_check_tells_public_from_private(line, allowed):
    assert (violations("tests/example.py", line) == []) == allowed


@pytest.mark.parametrize("module", ["sfgs_jax", *(f"sfgs_jax.{room}" for room in ROOMS), SE3])
def test_completion_shows_what_the_library_offers(module):
    names = [name for name in dir(importlib.import_module(module)) if not name.startswith("_")]
    # The import hook of the tests adds a name of its own.
    for name in filter("jaxtyping".__ne__, names):
        assert is_public(f"{module}.{name}")
        value = getattr(importlib.import_module(module), name)
        if inspect.ismodule(value):
            assert inside(value.__name__)


def test_a_room_may_look_into_itself_only():
    line = "from sfgs_jax.geometry._camera import Camera"
    assert violations("sfgs_jax/geometry/_frame.py", line) == []
    assert len(violations("sfgs_jax/gicp/_align.py", line)) == 1
