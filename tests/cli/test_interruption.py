"""Interruptions of a command: Ctrl-C and a polite kill, wherever they meet it."""

import gc
import os
import signal
import sys
import time

import pytest

from sfgs_jax.cli import Command, main


class Dying:
    """Python forgets what is raised while an object goes."""

    def __init__(self, signum):
        self.signum = signum

    def __del__(self):
        os.kill(os.getpid(), self.signum)
        time.sleep(1)


def while_an_object_goes(signum):
    del_me = Dying(signum)
    del del_me


def while_garbage_is_collected(signum):
    def collected(phase, info):
        gc.callbacks.remove(collected)
        os.kill(os.getpid(), signum)
        time.sleep(1)

    gc.callbacks.append(collected)
    gc.collect()


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("lost", [while_an_object_goes, while_garbage_is_collected])
def test_an_interruption_that_python_forgets_ends_the_command(lost, signum, capsys):
    # A shell's background jobs are born deaf to Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    went_on = []

    def run(words):
        lost(signum)
        went_on.append(True)
        time.sleep(60)
        return 0

    assert main(["wait"], commands={"wait": Command(run, "")}) == 130
    assert went_on
    assert capsys.readouterr().err == "sfgs-jax: interrupted.\n"


def test_a_command_leaves_the_process_as_it_was():
    signals = signal.SIGTERM, signal.SIGINT
    before = *map(signal.getsignal, signals), sys.unraisablehook
    assert main(["nothing"], commands={"nothing": Command(lambda words: 0, "")}) == 0
    assert (*map(signal.getsignal, signals), sys.unraisablehook) == before


@pytest.mark.parametrize("lost", [while_an_object_goes, while_garbage_is_collected])
def test_an_interruption_that_is_lost_at_the_end_kills_nobody(lost):
    signals = []
    before = signal.signal(signal.SIGTERM, lambda signum, frame: signals.append(signum))

    def run(words):
        lost(signal.SIGTERM)
        return 0

    try:
        # 130 on a machine so slow that it is sent again before the end.
        assert main(["end"], commands={"end": Command(run, "")}) in (0, 130)
        time.sleep(0.2)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not signals
