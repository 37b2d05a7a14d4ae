"""The SuperFeats network: layers, both branches, weights in files."""

from sfgs_jax.superfeats.network._layers import BatchStatistics as BatchStatistics
from sfgs_jax.superfeats.network._layers import Convolution as Convolution
from sfgs_jax.superfeats.network._layers import NormalisedConvolution as NormalisedConvolution
from sfgs_jax.superfeats.network._layers import convolve as convolve
from sfgs_jax.superfeats.network._layers import fold as fold
from sfgs_jax.superfeats.network._network import CELL as CELL
from sfgs_jax.superfeats.network._network import DESCRIPTOR_SIZE as DESCRIPTOR_SIZE
from sfgs_jax.superfeats.network._network import STRIDE as STRIDE
from sfgs_jax.superfeats.network._network import DenseFeatures as DenseFeatures
from sfgs_jax.superfeats.network._network import Network as Network
from sfgs_jax.superfeats.network._network import NetworkConfig as NetworkConfig
from sfgs_jax.superfeats.network._network import branches as branches
from sfgs_jax.superfeats.network._network import forward as forward
from sfgs_jax.superfeats.network._network import initialise_network as initialise_network
from sfgs_jax.superfeats.network._network import linear as linear
from sfgs_jax.superfeats.network._network import normalise as normalise
from sfgs_jax.superfeats.network._weights import load_weights as load_weights
from sfgs_jax.superfeats.network._weights import save_weights as save_weights
