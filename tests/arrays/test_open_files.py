"""Files that stay open: more than a shell allows by default."""

import subprocess
import sys
from pathlib import Path

import pytest

MANY = """
import resource
import sys
from pathlib import Path

import numpy as np

from sfgs_jax.slam.run import read_tensors, write_tensors

_, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
folder, mapped = Path(sys.argv[1]), []
for number in range(100):
    path = folder / f"{number}.safetensors"
    write_tensors(path, {"x": np.full(3, number)}, {"name": path.name})
    mapped.append(read_tensors(path)[0]["x"])
assert all(isinstance(x, np.memmap) and x[0] == number for number, x in enumerate(mapped))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
def test_a_run_may_have_more_images_on_disk_than_files_are_open_by_default(tmp_path):
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", MANY, tmp_path], cwd=root, check=True)
