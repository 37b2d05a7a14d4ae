import base64
import dataclasses
import json
import re
import shutil
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest

from sfgs_jax.evaluation import evaluate_run, write_report
from sfgs_jax.evaluation.report import depth_picture, plot_paths, rgb_picture
from sfgs_jax.geometry import Trajectory

_VOID = {"meta", "img", "br", "path", "use", "circle", "rect"}


class _Page(HTMLParser):
    """Collects links and checks that tags are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        if tag not in _VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture
def run(fabricated, tmp_path, monkeypatch):
    monkeypatch.setenv("SFGS_DATA", str(tmp_path / "nothing"))
    folder = tmp_path / "run"
    shutil.copytree(fabricated[0], folder)
    return folder, fabricated[1]


def _decode(address: str) -> np.ndarray:
    data = base64.b64decode(address.removeprefix("data:image/jpeg;base64,"))
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def test_the_page_shows_what_was_found_about_the_camera(run):
    folder, recording = run
    evaluate_run(folder, recording)
    assert "Read-out" not in _Page(write_report(folder, recording).read_text()).text
    found = {
        "times_s": {"depth_delay": 0.0123, "colour_readout": 0.03, "depth_readout": 0.025},
        "times_sigma_s": {"depth_delay": 0.0011, "colour_readout": 0.001, "depth_readout": 0.001},
        "depth_offsets_per_m": np.linspace(-0.005, 0.01, 96).reshape(6, 16).tolist(),
        "depth_offsets_sigma_per_m": np.full((6, 16), 0.0005).tolist(),
        "T_colour_depth_tangent": [0.0123, -0.004, 0.0, 0.002, 0.0, -0.01],
        "T_colour_depth_sigma": [0.001] * 3 + [0.0005] * 3,
    }
    (folder / "sensors.json").write_text(json.dumps(found))
    page = _Page(write_report(folder, recording).read_text())
    assert "Depth after colour12.3 ± 1.1 ms" in page.text
    assert "Correction of depth at 2 m-20 to 40 ± 2 mm" in page.text
    assert "Depth camera beside the colour camera (x, y, z)12.3, -4.0, 0.0 ± 1.0 mm" in page.text
    assert "Depth camera turned against it (x, y, z)0.11, 0.00, -0.57 ± 0.03 °" in page.text
    assert not page.open
    assert all(link.startswith(("data:", "#")) for link in page.links)


def test_the_page_holds_everything_itself(run):
    folder, recording = run
    evaluate_run(folder, recording)
    path = write_report(folder, recording)
    assert path == folder / "report.html"
    text = path.read_text()
    page = _Page(text)
    assert page.open == []
    pictures = [link for link in page.links if link.startswith("data:image/jpeg;base64,")]
    # Six evenly spaced views and the two worst, which may be among them; and the scale of depth.
    views = len(re.findall(r"Frame \d+", page.text))
    assert 6 <= views <= 8
    assert page.text.count("one of the worst") == 2
    assert len(pictures) == 5 * views + 1
    assert all(link.startswith(("data:", "#")) for link in page.links)
    assert not re.search(r"@import|url\((?!#)|<script|<link", text)
    assert _decode(pictures[0]).shape == (48, 64, 3)


def test_the_page_says_what_the_metrics_say(run):
    folder, recording = run
    metrics = evaluate_run(folder, recording)
    text = _Page(write_report(folder, recording).read_text()).text
    assert f"{metrics['psnr']['all']:.2f}" in text
    assert f"{metrics['psnr']['gs_icp']:.2f}" in text
    assert "12.50" in text  # the stage's median
    assert "slam.window" in text
    assert "Cannot read the LPIPS weights" in text
    assert "Position error" in text
    assert "3 σ from the first camera" in text
    assert "made <up>" in text  # escaped in the source, so it is text


def test_without_ground_truth_there_is_a_reason_and_no_error_plot(run):
    folder, recording = run
    recording = dataclasses.replace(recording, ground_truth=None)
    evaluate_run(folder, recording)
    text = _Page(write_report(folder, recording, num_views=2).read_text()).text
    assert "the recording has no ground truth" in text
    assert "Position error" not in text
    assert "Deviation of the position" in text
    assert "From above" in text


def test_the_page_of_a_run_that_was_not_evaluated(run):
    folder, recording = run
    (folder / "metrics.json").unlink()
    (folder / "config.json").unlink()
    (folder / "trajectory.txt").write_text("")
    (folder / "keyframes.txt").write_text("")
    assert "No frame has a pose" in write_report(folder, recording).read_text()


@pytest.mark.parametrize("length", [0.0, 0.005, 0.05, 5.0])
def test_paths_of_any_length_are_plotted_without_complaint(length, caplog):
    poses = np.tile(np.eye(4), (9, 1, 1))
    poses[:, 0, 3] = np.linspace(0, length, 9)
    path = Trajectory(np.arange(9.0), poses)
    svg = plot_paths(path, path[::4], None)
    assert svg.startswith("<svg")
    assert "From the side" in svg
    assert not caplog.records


def test_pictures_are_small_and_show_missing_depth_black():
    image = np.full((480, 640, 3), 0.5, np.float32)
    assert _decode(rgb_picture(image)).shape == (300, 400, 3)
    depth = np.full((32, 64), 1.0, np.float32)
    depth[:, 32:] = 0
    picture = _decode(depth_picture(depth, 0.5, 2.0))
    assert picture[:, 40:].max() < 20
    assert picture[:, :24].max() > 150


def test_names_from_outside_are_text_on_the_page(run):
    folder, recording = run
    evaluate_run(folder, recording)
    word = "<script>alert('1')</script><img src=x onerror=alert(2)>"
    metrics = json.loads((folder / "metrics.json").read_text())
    stage = next(iter(metrics["stages"].values()))
    metrics |= {
        "stages": {word: stage},
        "unavailable": {word: word},
        "versions": {word: word},
        "camera": {word: word},
    }
    (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "config.json").write_text(json.dumps({"source": word, word: {word: word}}))
    hostile = dataclasses.replace(recording, name=word, dataset=word)
    text = write_report(folder, hostile).read_text()
    assert "<script" not in text
    assert "<img src=x" not in text
    page = _Page(text)
    assert page.open == []
    # Title, heading, layout, stage, reason and its name, versions, camera, configuration.
    assert page.text.count(word) >= 12
