"""Registration of depth images."""

from sfgs_jax.gicp.align import align as align
from sfgs_jax.gicp.cloud import OrganisedCloud as OrganisedCloud
from sfgs_jax.gicp.cloud import OrganisedLevel as OrganisedLevel
from sfgs_jax.gicp.cloud import prepare as prepare
from sfgs_jax.gicp.config import GicpConfig as GicpConfig
from sfgs_jax.gicp.result import RegistrationResult as RegistrationResult
