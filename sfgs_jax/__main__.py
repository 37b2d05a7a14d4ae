"""`python -m sfgs_jax` is `sfgs-jax`."""

import sys

from sfgs_jax.cli import main

sys.exit(main())
