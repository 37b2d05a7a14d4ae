"""XFeat's network for images of other sizes than its file's.

The file is an export for 640x640. The size stands in three places: the input, the sizes to which coarse maps
are enlarged, and the slices that cut the image into 8x8 cells. The graph for another size has the same
weights; at 640x640 it gives the same numbers.
"""

from pathlib import Path

import numpy as np
import onnx  # pyright: ignore[reportMissingImports]
from onnx import helper, numpy_helper  # pyright: ignore[reportMissingImports]

_CELL = 8
_GREY = "/ReduceMean_output_0"
_CELLS = "/Reshape_1_output_0"


def resized_xfeat(weights: Path, height: int, width: int) -> bytes:
    """The network as a model file for images of another size.

    Args:
        weights: file of the network for 640x640.
        height: of the images, pixels, a multiple of 32.
        width: of the images, pixels, a multiple of 32.
    """
    model = onnx.load(str(weights))
    graph = model.graph
    makers = {name: node for node in graph.node for name in node.output}
    enlarged = {name for node in graph.node if node.op_type == "Concat" for name in node.input}
    dropped = _ancestors(makers, start=_CELLS, end=_GREY)

    kept = []
    for node in graph.node:
        if node.op_type == "Constant" and node.output[0] in enlarged and node.output[0] not in dropped:
            size = np.array([height // _CELL, width // _CELL], np.int64)
            node.attribute[0].t.CopyFrom(numpy_helper.from_array(size))
        if node.output[0] == _CELLS:
            kept.append(helper.make_node("SpaceToDepth", [_GREY], [_CELLS], blocksize=_CELL))
        elif node.output[0] not in dropped:
            kept.append(node)
    del graph.node[:]
    graph.node.extend(kept)

    dimensions = graph.input[0].type.tensor_type.shape.dim
    dimensions[2].dim_value, dimensions[3].dim_value = height, width
    del graph.value_info[:]
    for output in graph.output:
        for dimension in output.type.tensor_type.shape.dim:
            dimension.Clear()
    onnx.checker.check_model(model)
    return model.SerializeToString()


def _ancestors(makers: dict, *, start: str, end: str) -> set[str]:
    """Names of the values that `start` is computed from, with `start` and without `end`."""
    found, open_names = set(), [start]
    while open_names:
        name = open_names.pop()
        if name in found or name == end or name not in makers:
            continue
        found.add(name)
        open_names.extend(makers[name].input)
    return found
