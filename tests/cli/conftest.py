"""Fixtures of the tests that run commands."""

import jax
import pytest


@pytest.fixture(scope="module")
def own_compilation_cache(tmp_path_factory):
    """Tests leave the user's cache alone, and JAX's settings as they were."""
    names = (
        "jax_compilation_cache_dir",
        "jax_persistent_cache_min_compile_time_secs",
        "jax_persistent_cache_min_entry_size_bytes",
    )
    before = {name: jax.config.values[name] for name in names}
    with pytest.MonkeyPatch.context() as patch:
        folder = before["jax_compilation_cache_dir"] or str(tmp_path_factory.mktemp("programs"))
        patch.setenv("JAX_COMPILATION_CACHE_DIR", folder)
        yield
    for name, value in before.items():
        jax.config.update(name, value)
