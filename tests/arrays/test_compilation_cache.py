"""The compilation cache of library users: private, one for each jaxlib, and used by the next process."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from sfgs_jax import enable_cache
from sfgs_jax.arrays import InputError, cache_folder

PROGRAM = """
import os
os.umask(0)
import jax, jax.numpy as jnp, sfgs_jax
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.extend([1] * name.endswith("cache_hits")))
folder = sfgs_jax.enable_cache()
jax.jit(lambda x: jnp.sort(x @ x))(jnp.ones((20, 20))).block_until_ready()
print(folder, len(hits))
"""


def run(home: Path) -> tuple[Path, int, str]:
    """The cache's folder, the programs found in it, and the messages of a process with this home."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "XDG_"))}
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=environment | {"HOME": str(home), "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=True,
    )
    folder, hits = process.stdout.split()
    return Path(folder), int(hits), process.stderr


def test_the_second_process_finds_what_the_first_compiled(tmp_path):
    folder, hits, _ = run(tmp_path)
    assert folder == tmp_path / ".cache" / "sfgs_jax" / f"jaxlib-{version('jaxlib')}"
    assert hits == 0
    programs = set(folder.iterdir())
    assert programs
    # Private even though this process makes every file open to all.
    for each in (folder, folder.parent):
        assert each.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o777)
    again, hits, messages = run(tmp_path)
    assert again == folder
    assert hits > 0
    assert {path for path in folder.iterdir() if path.name.endswith("-cache")} <= programs
    assert folder.stat().st_mode & 0o777 == 0o700
    assert messages == ""


def test_jaxs_own_setting_comes_first(tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="JAX_COMPILATION_CACHE_DIR"):
        enable_cache(tmp_path / "file" / "cache")
