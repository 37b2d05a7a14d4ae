"""`sfgs-jax check` prints the findings, and its exit status says whether there was a warning."""

import json

import pytest

from sfgs_jax.cli import main
from sfgs_jax.datasets import SyntheticRecording, write_recording


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A plain folder with a good recording."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    write_recording(SyntheticRecording(num_frames=20, width=80, height=60), folder, layout="folder")
    return folder


def test_a_good_recording_ends_with_0(folder, capsys):
    assert main(["check", str(folder)]) == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert lines[0] == "room (folder)"
    assert lines[-1] == "Nothing was found that would spoil a run."
    assert not any(line.startswith("WARNING") for line in lines)
    assert "looking at frame 20 of 20" in shown.err


def test_a_warning_comes_last_and_says_what_to_change(folder, capsys):
    assert main(["check", str(folder), "--reader.depth-scale", "5000"]) == 1
    warning, advice, end = capsys.readouterr().out.splitlines()[-3:]
    assert warning.startswith("WARNING  depth scale")
    assert advice.strip() == "Set depth_scale (or --reader.depth-scale) to 1000; it is 5000."
    assert end.startswith("1 warning")


def test_json_holds_every_number(folder, capsys):
    assert main(["check", str(folder), "--json", "--reader.depth-scale", "200"]) == 1
    shown = capsys.readouterr()
    assert shown.err == ""
    (scale,) = [found for found in json.loads(shown.out)["findings"] if found["question"] == "depth scale"]
    assert scale["severity"] == "warning"
    assert scale["evidence"]["depth per pose"] == pytest.approx(5, rel=0.1)


def test_what_can_not_be_read_ends_with_2(tmp_path, capsys):
    assert main(["check", str(tmp_path / "nowhere")]) == 2
    assert capsys.readouterr().err.startswith("sfgs-jax: There is no ")
