"""A run of a red wall, as the command line finds it in a folder."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from sfgs_jax.cli import RunConfig, to_json
from sfgs_jax.datasets import ReaderOptions
from sfgs_jax.geometry import Trajectory, format_tum
from sfgs_jax.slam import SlamConfig
from sfgs_jax.splatting import Gaussians, save_ply

RED = np.asarray([1.0, 0.2, 0.1])


def red_wall() -> Gaussians:
    """Opaque discs on the plane z = 2 m, larger than the view."""
    x, y = np.meshgrid(np.arange(-2.4, 2.41, 0.1), np.arange(-2.0, 2.01, 0.1))
    n = x.size
    means = np.stack([x.ravel(), y.ravel(), np.full(n, 2.0)], axis=1)
    return Gaussians(
        means=jnp.asarray(means, jnp.float32),
        quaternions=jnp.tile(jnp.asarray([[1.0, 0, 0, 0]]), (n, 1)),
        log_scales=jnp.log(jnp.tile(jnp.asarray([[0.08, 0.08, 0.002]]), (n, 1))),
        opacity_logits=jnp.full((n,), 4.0),
        sh=jnp.asarray(np.tile((RED - 0.5) / 0.28209479, (n, 1, 1)), jnp.float32),
        valid=jnp.ones(n, bool),
    )


def way() -> Trajectory:
    """Four poses that come nearer to the wall by 0.1 m each."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 2, 3] = 0.1 * np.arange(4)
    return Trajectory(np.arange(4) / 30, poses)


def write_run(folder: Path, *, source: str | None = "synthetic:frames=1,width=40,height=30") -> Path:
    """The files of a run of the wall; without a source there is no config.json."""
    save_ply(folder / "map.ply", red_wall())
    (folder / "trajectory.txt").write_text(format_tum(way()))
    if source is not None:
        config = RunConfig(source, "synthetic", ReaderOptions(), SlamConfig())
        (folder / "config.json").write_text(to_json(config))
    return folder
