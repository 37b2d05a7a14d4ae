import json

import pytest
from fabricated_run import fabricate


@pytest.fixture(scope="session")
def fabricated(tmp_path_factory):
    """A run's folder and its recording; tests copy the folder before they write to it."""
    folder = tmp_path_factory.mktemp("run")
    recording = fabricate(folder)
    metrics = {
        "frames": {"total": 11, "tracked": 11, "keyframes": 3},
        "stages": {"tracking": {"median_ms": 12.5, "p95_ms": 20.0}},
        "ate": {"rmse_m": 123.0},
    }
    (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "config.json").write_text(json.dumps({"source": "<b>", "slam": {"window": 3}}))
    return folder, recording
