"""Progress is plain lines without a terminal, and nothing when quiet."""

from sfgs_jax.cli import reporting


def test_plain_lines_come_at_the_beginning_now_and_then_and_at_the_end(capsys):
    clock = iter([0.0, 1.0, 6.0, 7.0, 8.0, 9.0, 14.0])
    with reporting(quiet=False, clock=lambda: next(clock)) as report:
        report("frame", 0, 4, "compiling")
        for done in range(1, 5):
            report("frame", done, 4, "fine")
        report("frame", 4, 4, "polishing")
        report("frame", 4, 4, "polished")
    assert capsys.readouterr().err.splitlines() == [
        "frame 0 of 4, compiling",
        "frame 2 of 4, 0:10 left, fine",
        "frame 4 of 4, fine",
        "frame 4 of 4, polished",
    ]


def test_a_task_has_its_own_beginning_and_end(capsys):
    with reporting(quiet=False, clock=lambda: 0.0) as report:
        report("frame", 1, 1)
        for step in range(1, 4):
            report("refining the map, step", step, 3)
    assert capsys.readouterr().err.splitlines() == [
        "frame 1 of 1",
        "refining the map, step 1 of 3",
        "refining the map, step 3 of 3",
    ]


def test_quiet_prints_nothing(capsys):
    with reporting(quiet=True) as report:
        report("frame", 1, 1, "fine")
    assert capsys.readouterr().err == ""
