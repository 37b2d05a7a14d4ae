"""The command line, `sfgs-jax`."""

from sfgs_jax.cli.main import main as main
