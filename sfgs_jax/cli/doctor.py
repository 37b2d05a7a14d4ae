"""`sfgs-jax doctor`: what the installation sees, and what is missing."""

import dataclasses
import os
import tempfile
from importlib.metadata import PackageNotFoundError, requires, version

import jax
import tyro

from sfgs_jax import __version__
from sfgs_jax.cli.cache import cache_folder
from sfgs_jax.evaluation import default_lpips_path


@dataclasses.dataclass(frozen=True)
class DoctorArguments:
    """Say what JAX sees, which packages are installed, and what is missing."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line of the report: what was looked at, what was found, and whether something depends on it."""

    name: str
    found: str
    good: bool = True


def doctor_command(arguments: list[str]) -> int:
    """Run the command. Exit status 1 when something that a run needs is missing."""
    tyro.cli(DoctorArguments, prog="sfgs-jax doctor", args=arguments)
    findings = [*_platform(), *_packages(), _opencv(), _cache(), *_data()]
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        print(f"{'ok     ' if finding.good else 'missing'} {finding.name:<{width}}  {finding.found}")
    return 0 if all(finding.good for finding in findings) else 1


def _platform() -> list[Finding]:
    devices = ", ".join(f"{device.platform}:{device.device_kind}" for device in jax.devices())
    return [
        Finding("sfgs-jax", __version__),
        Finding("JAX devices", f"{devices}; default {jax.default_backend()}"),
        Finding(
            "CPU cores",
            str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()),
        ),
    ]


def _packages() -> list[Finding]:
    findings = []
    for requirement in requires("sfgs-jax") or []:
        if "extra ==" in requirement:
            continue
        name = requirement
        for separator in "<>=!~;[ ":
            name = name.split(separator)[0]
        try:
            findings.append(Finding(name, version(name)))
        except PackageNotFoundError:
            findings.append(Finding(name, f"not installed: pip install '{requirement}'", good=False))
    return findings


def _opencv() -> Finding:
    """The non-headless wheels overwrite the same files and pull in a window system."""
    others = []
    for name in ("opencv-python", "opencv-contrib-python"):
        try:
            others.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    if others:
        return Finding(
            "OpenCV wheel",
            f"{', '.join(others)} is installed beside the headless one: uninstall it",
            good=False,
        )
    return Finding("OpenCV wheel", "headless only")


def _cache() -> Finding:
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        return Finding(
            "compilation cache",
            f"{folder} cannot be written ({error.strerror}): every start compiles anew; "
            "set JAX_COMPILATION_CACHE_DIR",
            good=False,
        )
    programs = sum(1 for path in folder.iterdir() if path.name.endswith("-cache"))
    return Finding("compilation cache", f"{folder}, {programs} programs")


def _data() -> list[Finding]:
    """Optional: without these weights a run goes well and its LPIPS is left out."""
    weights = default_lpips_path()
    found = "found" if weights.is_file() else "not there, so no LPIPS (SFGS_DATA says where to look)"
    return [Finding("LPIPS weights", f"{weights}, {found}")]
