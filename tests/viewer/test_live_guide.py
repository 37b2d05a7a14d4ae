"""The section on live runs in docs/viewer.md: its example runs, and its controls and options exist."""

import dataclasses
import inspect
import re
from pathlib import Path

from sfgs_jax import slam
from sfgs_jax.cli import RunOptions
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.viewer import LiveView
from tests.viewer.made_up_runs import first_state, progress_of

GUIDE = (Path(__file__).parents[2] / "docs" / "viewer.md").read_text().split("\n## Live\n")[1]
(EXAMPLE,) = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)


def test_the_example_runs(monkeypatch, tmp_path, capsys):
    recording = SyntheticRecording(num_frames=3, width=80, height=60)
    signature = inspect.signature(slam.run)

    def made_up_run(*arguments, **options) -> slam.Run:
        observer = signature.bind(*arguments, **options).arguments["observer"]
        run = slam.Run(first_state(recording))
        for report in progress_of(recording, run.state):
            observer(report)
            run = report.run
        return run

    monkeypatch.setattr(slam, "run", made_up_run)
    monkeypatch.chdir(tmp_path)
    example = EXAMPLE.replace('"my_desk"', '"synthetic:frames=3,width=80,height=60"')
    assert example != EXAMPLE
    names: dict = {}
    exec(compile(example, "viewer.md", "exec"), names)  # the text under test is our own
    assert capsys.readouterr().out.startswith("http://127.0.0.1:")
    assert (tmp_path / "runs" / "my_desk" / "map.ply").exists()
    assert names["run"].num_frames == 3


def test_every_control_and_option_exists():
    folder = Path(inspect.getfile(LiveView)).parent
    source = "".join((folder / name).read_text() for name in ("_live_page.py", "_live_scene.py"))
    rows = re.findall(r"^\| ([A-Z0-9][^|]*) \|", GUIDE, re.MULTILINE)
    controls = [control for row in rows for control in row.split(", ")]
    assert len(controls) == 14
    assert all(f'"{control}"' in source for control in controls)
    options = {f"--{field.name}".replace("_", "-") for field in dataclasses.fields(RunOptions)}
    assert {"--view", "--view-port", "--view-host"} <= set(re.findall(r"`?(--view[a-z-]*)", GUIDE)) <= options
    assert "slam.combined(" in GUIDE
    assert callable(slam.combined)
