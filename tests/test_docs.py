"""The site and the architecture page name everything that is there, and nothing that is not."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PACKAGES = sorted(
    path.parent.relative_to(ROOT / "sfgs_jax") for path in (ROOT / "sfgs_jax").glob("**/__init__.py")
)


def tree_of_the_architecture_page() -> list[Path]:
    """Folders of the tree in docs/architecture.md, relative to sfgs_jax."""
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```\nsfgs_jax/\n(.*?)```", text, re.DOTALL)
    folders: list[Path] = []
    parents: dict[int, Path] = {0: Path()}
    for indent, name in re.findall(r"^( +)([a-z_]+)/", block, re.MULTILINE):
        depth = len(indent) // 2
        parents[depth] = parents[depth - 1] / name
        folders.append(parents[depth])
    return folders


def test_the_tree_names_every_package():
    assert sorted(tree_of_the_architecture_page()) == [path for path in PACKAGES if path != Path()]


@pytest.mark.parametrize("room", [path.name for path in PACKAGES if len(path.parts) == 1])
def test_every_room_has_an_api_page(room):
    assert f"::: sfgs_jax.{room}\n" in (DOCS / "api" / f"{room}.md").read_text(encoding="utf-8")


def test_every_dependency_has_its_reason():
    wanted = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (block,) = re.findall(r"^dependencies = \[(.*?)^\]", wanted, re.DOTALL | re.MULTILINE)
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    for name in re.findall(r'"([A-Za-z-]+)', block):
        if name != "jaxlib":
            assert name in page, name


@pytest.mark.parametrize("page", sorted(DOCS.glob("**/*.md")), ids=lambda path: path.stem)
def test_included_files_are_there(page):
    """A formatter that takes an include for Python pulls it apart, and the page shows a riddle."""
    text = page.read_text(encoding="utf-8")
    included = re.findall(r'^--8<-- "(.+)"$', text, re.MULTILINE)
    assert text.count("--8") == len(included)
    for name in included:
        assert (ROOT / name).is_file(), name


def test_every_example_is_shown_once():
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("**/*.md"))
    for path in (ROOT / "examples").glob("*.py"):
        assert pages.count(f'--8<-- "examples/{path.name}"') == 1, path.name
