"""`sfgs-jax doctor` says what is there and what is missing."""

from importlib.metadata import PackageNotFoundError

import sfgs_jax.cli.doctor as doctor
from sfgs_jax.cli.main import main


def test_a_sound_installation(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert "cpu" in shown
    assert str(tmp_path / "cache") in shown
    assert not any(line.startswith("missing") for line in shown.splitlines())


def test_a_missing_package_and_a_read_only_cache_are_named(capsys, tmp_path, monkeypatch):
    real = doctor.version

    def version(name):
        if name == "viser":
            raise PackageNotFoundError(name)
        return real(name)

    (tmp_path / "file").write_text("")
    monkeypatch.setattr(doctor, "version", version)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "file" / "cache"))
    assert main(["doctor"]) == 1
    missing = [line for line in capsys.readouterr().out.splitlines() if line.startswith("missing")]
    assert any("viser" in line and "pip install" in line for line in missing)
    assert any("compilation cache" in line for line in missing)


def test_two_opencv_wheels_are_noticed(monkeypatch, capsys):
    real = doctor.version
    monkeypatch.setattr(doctor, "version", lambda name: "4.1" if name == "opencv-python" else real(name))
    main(["doctor"])
    assert "opencv-python 4.1 is installed beside the headless one" in capsys.readouterr().out
