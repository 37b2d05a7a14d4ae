"""`sfgs-jax doctor`: the state of the installation, and what it lacks."""

import dataclasses
import importlib.metadata
import os
import tempfile
from collections.abc import Callable
from typing import Literal

import jax
import tyro

from sfgs_jax import __version__
from sfgs_jax.arrays import cache_folder
from sfgs_jax.evaluation import default_lpips_path

_FAULTY = {
    ("jaxlib", "0.10.2"): "returns wrong sums on CPUs for some shapes (jax#39103); install 0.10.1",
}
"""Releases that must not be used, with the reason."""

_Version = Callable[[str], str]


@dataclasses.dataclass(frozen=True)
class DoctorArguments:
    """List the devices of JAX, the installed packages, and everything that is missing."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line of the report.

    Attributes:
        name: subject of the line.
        found: what was found.
        state: "missing" and "wrong" keep the system from working as it should.
    """

    name: str
    found: str
    state: Literal["ok", "missing", "wrong"] = "ok"


def doctor_command(arguments: list[str], *, version: _Version = importlib.metadata.version) -> int:
    """Run the command.

    Args:
        arguments: words after `sfgs-jax doctor`.
        version: gives the version of an installed distribution, else raises PackageNotFoundError.

    Returns:
        The exit status: 1 if something that a run needs is missing or wrong.
    """
    tyro.cli(DoctorArguments, prog="sfgs-jax doctor", args=arguments)
    findings = [*_platform(), *_packages(version), _opencv(version), _cache(), _lpips()]
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        print(f"{finding.state:<7} {finding.name:<{width}}  {finding.found}")
    return 0 if all(finding.state == "ok" for finding in findings) else 1


def _platform() -> list[Finding]:
    devices = ", ".join(f"{device.platform}:{device.device_kind}" for device in jax.devices())
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return [
        Finding("sfgs-jax", __version__),
        Finding("JAX devices", f"{devices}; default {jax.default_backend()}"),
        Finding("CPU cores", str(cores)),
    ]


def _packages(version: _Version) -> list[Finding]:
    findings = []
    for requirement in importlib.metadata.requires("sfgs-jax") or []:
        if "extra ==" in requirement:
            continue
        name = requirement
        for separator in "<>=!~;[ ":
            name = name.split(separator)[0]
        try:
            installed = version(name)
        except importlib.metadata.PackageNotFoundError:
            findings.append(Finding(name, f"not installed: pip install '{requirement}'", "missing"))
            continue
        fault = _FAULTY.get((name, installed))
        findings.append(Finding(name, f"{installed} {fault}", "wrong") if fault else Finding(name, installed))
    return findings


def _opencv(version: _Version) -> Finding:
    """The non-headless wheels overwrite the same files and pull in a window system."""
    others = []
    for name in ("opencv-python", "opencv-contrib-python"):
        try:
            others.append(f"{name} {version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    if others:
        found = f"{', '.join(others)} is installed beside the headless one: uninstall it"
        return Finding("OpenCV wheel", found, "wrong")
    return Finding("OpenCV wheel", "headless only")


def _cache() -> Finding:
    folder = cache_folder()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        found = (
            f"{folder} cannot be written ({error.strerror}): every start compiles anew; "
            "set JAX_COMPILATION_CACHE_DIR"
        )
        return Finding("compilation cache", found, "missing")
    programs = sum(1 for path in folder.iterdir() if path.name.endswith("-cache"))
    return Finding("compilation cache", f"{folder}, {programs} programs")


def _lpips() -> Finding:
    """Optional: without these weights a run goes well and its LPIPS is left out."""
    weights = default_lpips_path()
    found = "found" if weights.is_file() else "not there, so no LPIPS (SFGS_DATA says where to look)"
    return Finding("LPIPS weights", f"{weights}, {found}")
