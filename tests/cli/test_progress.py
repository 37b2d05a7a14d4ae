"""Progress is plain lines where there is no terminal, and nothing when quiet."""

from sfgs_jax.cli import progress


def test_plain_lines_come_now_and_then_and_at_the_end(capsys, monkeypatch):
    clock = iter([0.0, 1.0, 6.0, 7.0, 8.0, 9.0, 14.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.reporting("frames", 4, quiet=False) as report:
        for done in range(1, 5):
            report(done, "fine")
        report(4, "polishing")
        report(4, "polished")
    assert capsys.readouterr().err == "frames 2/4 fine\nframes 4/4 fine\nframes 4/4 polished\n"


def test_quiet_prints_nothing(capsys):
    with progress.reporting("frames", 1, quiet=True) as report:
        report(1, "fine")
    assert capsys.readouterr().err == ""
