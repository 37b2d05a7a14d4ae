"""`python -m sfgs_jax.cli` is `sfgs-jax`."""

import sys

from sfgs_jax.cli.main import main

sys.exit(main())
