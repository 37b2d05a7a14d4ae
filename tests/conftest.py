"""Every test runs with shapes and types checked, strict promotion, and warnings as errors."""

import gc
import os
import socket
import threading
from pathlib import Path

from jaxtyping import install_import_hook

install_import_hook("sfgs_jax", "beartype.beartype")

import jax  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402

from sfgs_jax.arrays import BACKGROUND_THREAD, return_free_memory  # noqa: E402

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
# A program that carries the call stack of each of its operations takes a twentieth longer to compile.
jax.config.update("jax_include_full_tracebacks_in_locations", False)

# Tracing makes millions of objects that live long. Looking for cycles among them at Python's default rate
# takes a third of its time.
gc.set_threshold(100_000, 20, 100)


_FIRST = (
    "slam/test_differentiability_guide.py",
    "slam/test_depth_estimate.py",
    "slam/test_lost.py",
    "slam/test_mapping.py",
    "slam/test_adjustment.py",
    "slam/test_timing_estimate.py",
    "slam/test_contradictions.py",
    "slam/test_tiled_wall.py",
    "slam/test_merge.py",
    "slam/test_focal_lengths.py",
    "slam",
    "test_examples.py",
    "factor_graph/test_solve.py",
    "cli/test_run_command.py",
    "cli/test_merge_command.py",
    "cli/test_batch_command.py",
    "splatting/test_rendering.py",
    "viewer/test_live_view.py",
    "viewer/test_server_rendering.py",
    "viewer/test_page_of_a_run.py",
    "superfeats/test_training.py",
    "experiments/test_learn_through_slam.py",
    "experiments/test_train_superfeats.py",
    "experiments/test_self_calibration.py",
    "experiments/test_learned_robustness.py",
    "gicp/test_point_clouds.py",
    "gicp/test_exact_products.py",
    "gicp/test_matches.py",
    "gicp/test_derivatives.py",
)
"""Files and folders, about from the longest on, and those of one folder together, for they share programs."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest, so that no worker is left with one at the end."""
    folder = Path(__file__).parent
    places = {folder / name: place for place, name in enumerate(_FIRST)}
    last = len(places)
    items.sort(key=lambda item: places.get(item.path, places.get(item.path.parent, last)))


def pytest_unconfigure() -> None:
    """Look for no cycles as the process ends: among millions of objects that takes seconds."""
    gc.freeze()


_MANY_MAPS = 15_000
"""Memory maps of a process beyond which its compiled programs go: it holds 3 GB then. Linux allows 65,530,
and the programs of one file take up to 8,000."""


@pytest.fixture(autouse=True, scope="module")
def _programs_of_finished_files():
    """Let go of compiled programs where there are many: a process has room for so many, and then crashes.

    A few may stay, for the next file may use them as well.
    """
    yield
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > _MANY_MAPS:
        jax.clear_caches()
        # Half of a worker's memory would stay with it: what the compiler has used between the programs.
        return_free_memory()


@pytest.fixture
def key() -> jax.Array:
    """A fixed random key."""
    return jax.random.key(0)


@pytest.fixture
def rng() -> np.random.Generator:
    """A fixed NumPy generator."""
    return np.random.default_rng(0)


@pytest.fixture
def float64():
    """Run a test in float64."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session")
def all_compilations():
    """A list that grows by one with every program that XLA compiles while something waits for it."""
    names: list[str] = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        aside = threading.current_thread().name.startswith(BACKGROUND_THREAD)
        if event == "/jax/core/compile/backend_compile_duration" and not aside:
            names.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.fixture
def compilations(all_compilations):
    """The same, empty at the beginning of a test."""
    all_compilations.clear()
    return all_compilations


@pytest.fixture(scope="session")
def sfgs_data() -> Path:
    """The folder with the real recordings and weights; without it a test is skipped, in CI it fails."""
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    if not (root / "data").is_dir():
        message = f"no real recordings at {root}; set SFGS_DATA to the folder that holds data/ and weights/"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(message)
        pytest.skip(message)
    return root


@pytest.fixture(scope="module")
def browser():
    """A headless browser; without one installed a test is skipped, in CI it fails."""
    from tests.viewer.browser import PROGRAMS, find_chromium, headless

    program = find_chromium()
    if program is None:
        message = f"no browser is installed: one of {', '.join(PROGRAMS)} (apt-get install chromium)"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(message)
        pytest.skip(message)
    with headless(program) as running:
        yield running


@pytest.fixture
def free_port() -> int:
    """A port that nothing listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
