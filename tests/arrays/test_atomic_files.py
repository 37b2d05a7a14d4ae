"""A file is either whole or as it was."""

import os

import pytest

from sfgs_jax.arrays import make_folder, write_atomically


def test_replaces_the_whole_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    write_atomically(path, "a long first content")
    write_atomically(path, b"short")
    assert path.read_bytes() == b"short"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_atomically(path, "old")

    def full_disk(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match=r"No space.*a\.txt'"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_names_are_forced_to_the_disk_after_the_content(tmp_path, monkeypatch):
    synced, sync = [], os.fsync

    def told(descriptor):
        synced.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", told)
    make_folder(tmp_path / "a/b")
    assert synced == [f"{tmp_path}/a", str(tmp_path)]
    write_atomically(tmp_path / "a/b/c.txt", "text")
    assert os.path.basename(synced[2]).startswith(".c.txt.")
    assert synced[3:] == [f"{tmp_path}/a/b"]


def test_a_folder_that_cannot_be_forced_to_the_disk_takes_files(tmp_path, monkeypatch):
    sync = os.fsync

    def refuse(descriptor):
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):
            raise OSError(22, "Invalid argument")
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", refuse)
    write_atomically(tmp_path / "a.txt", "text")
    assert (tmp_path / "a.txt").read_text() == "text"
