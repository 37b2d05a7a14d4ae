"""Ground room: sorting, prefix sums, small matrices, capacities, blockwise derivatives, pytrees, files.

Each file holds one idiom and the reason for it.
"""

from sfgs_jax.arrays._arguments import described as described
from sfgs_jax.arrays._arguments import is_array as is_array
from sfgs_jax.arrays._arguments import is_floating as is_floating
from sfgs_jax.arrays._atomic_files import remove_unfinished as remove_unfinished
from sfgs_jax.arrays._atomic_files import write_atomically as write_atomically
from sfgs_jax.arrays._blockwise_vjp import map_used_rows as map_used_rows
from sfgs_jax.arrays._capacities import bucket as bucket
from sfgs_jax.arrays._capacities import doubled as doubled
from sfgs_jax.arrays._capacities import padded as padded
from sfgs_jax.arrays._capacities import rounded_up as rounded_up
from sfgs_jax.arrays._compilation_cache import cache_folder as cache_folder
from sfgs_jax.arrays._compilation_cache import enable_cache as enable_cache
from sfgs_jax.arrays._eigenpair import smallest_eigenpair as smallest_eigenpair
from sfgs_jax.arrays._errors import FrameError as FrameError
from sfgs_jax.arrays._errors import InputError as InputError
from sfgs_jax.arrays._excerpts import excerpt as excerpt
from sfgs_jax.arrays._prefix_sums import prefix_sums as prefix_sums
from sfgs_jax.arrays._printing import Text as Text
from sfgs_jax.arrays._printing import is_known as is_known
from sfgs_jax.arrays._printing import printed as printed
from sfgs_jax.arrays._printing import printed_count as printed_count
from sfgs_jax.arrays._printing import printed_fields as printed_fields
from sfgs_jax.arrays._pytrees import pytree as pytree
from sfgs_jax.arrays._settings import check_choice as check_choice
from sfgs_jax.arrays._settings import check_counts as check_counts
from sfgs_jax.arrays._settings import check_positive as check_positive
from sfgs_jax.arrays._settings import check_range as check_range
from sfgs_jax.arrays._small_matrices import INDICES as INDICES
from sfgs_jax.arrays._small_matrices import SQUARE as SQUARE
from sfgs_jax.arrays._small_matrices import Symmetric as Symmetric
from sfgs_jax.arrays._small_matrices import apply as apply
from sfgs_jax.arrays._small_matrices import apply_transposed as apply_transposed
from sfgs_jax.arrays._small_matrices import back_substitution as back_substitution
from sfgs_jax.arrays._small_matrices import cholesky as cholesky
from sfgs_jax.arrays._small_matrices import dot as dot
from sfgs_jax.arrays._small_matrices import forward_substitution as forward_substitution
from sfgs_jax.arrays._small_matrices import from_upper_triangles as from_upper_triangles
from sfgs_jax.arrays._small_matrices import identity_like as identity_like
from sfgs_jax.arrays._small_matrices import multiply as multiply
from sfgs_jax.arrays._small_matrices import multiply_transposed as multiply_transposed
from sfgs_jax.arrays._small_matrices import outer as outer
from sfgs_jax.arrays._small_matrices import symmetric_inverse as symmetric_inverse
from sfgs_jax.arrays._small_matrices import symmetric_product as symmetric_product
from sfgs_jax.arrays._small_matrices import upper_triangles as upper_triangles
from sfgs_jax.arrays._sorting import digit_bits as digit_bits
from sfgs_jax.arrays._sorting import from_ordered_bits as from_ordered_bits
from sfgs_jax.arrays._sorting import masked_median as masked_median
from sfgs_jax.arrays._sorting import ordered_bits as ordered_bits
from sfgs_jax.arrays._sorting import packed_argmin as packed_argmin
from sfgs_jax.arrays._sorting import sort_packed as sort_packed
from sfgs_jax.arrays._sorting import stable_argsort as stable_argsort
from sfgs_jax.arrays._sorting import stable_order as stable_order
