"""`sfgs-jax doctor` says what is there, what is missing and what is wrong."""

from importlib.metadata import PackageNotFoundError, version

from sfgs_jax.cli import doctor_command, main


def lines(capsys, state: str) -> list[str]:
    return [line for line in capsys.readouterr().out.splitlines() if line.startswith(state)]


def test_a_sound_installation(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert "cpu" in shown
    assert str(tmp_path / "cache") in shown
    assert all(line.startswith("ok ") for line in shown.splitlines())


def test_a_missing_package_and_a_read_only_cache_are_named(capsys, tmp_path, monkeypatch):
    def without_viser(name: str) -> str:
        if name == "viser":
            raise PackageNotFoundError(name)
        return version(name)

    (tmp_path / "file").write_text("")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "file" / "cache"))
    assert doctor_command([], version=without_viser) == 1
    missing = lines(capsys, "missing")
    assert any("viser" in line and "pip install" in line for line in missing)
    assert any("compilation cache" in line for line in missing)


def test_two_opencv_wheels_are_noticed(capsys):
    assert doctor_command([], version=lambda name: "4.1" if name == "opencv-python" else version(name)) == 1
    (line,) = lines(capsys, "wrong")
    assert "opencv-python 4.1 is installed beside the headless one" in line


def test_a_jaxlib_with_wrong_sums_is_named(capsys):
    assert doctor_command([], version=lambda name: "0.10.2" if name == "jaxlib" else version(name)) == 1
    (line,) = lines(capsys, "wrong")
    assert line.endswith("0.10.2 returns wrong sums on CPUs for some shapes (jax#39103); install 0.10.1")
