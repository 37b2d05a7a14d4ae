"""requirements.lock holds what constraints.txt and pyproject.toml say, each with its hashes."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
ADVICE = "run `make lock`"


def _name(text: str) -> str:
    """Name of a requirement, as packages are compared."""
    return re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", text)[0]).lower()


def _pins(text: str) -> dict[str, str]:
    return {
        _name(name): version for name, version in re.findall(r"^([\w.-]+)==([^\s;]+)", text, re.MULTILINE)
    }


def test_the_lock_has_every_requirement_as_it_is_pinned():
    lock, pins = (_pins((ROOT / name).read_text()) for name in ("requirements.lock", "constraints.txt"))
    assert {name: version for name, version in lock.items() if pins.get(name) != version} == {}, ADVICE
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = {_name(text) for text in (*project["dependencies"], *extras["dev"], *extras["docs"])}
    assert needed - set(lock) == set(), ADVICE


def test_every_package_has_a_hash():
    blocks = re.split(r"^(?=\S)", (ROOT / "requirements.lock").read_text(), flags=re.MULTILINE)
    assert [block for block in blocks if block and "--hash=sha256:" not in block] == []
