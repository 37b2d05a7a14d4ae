"""Time of `import sfgs_jax` in a fresh process, and the packages that it goes to.

    python -m benchmarks.import_time [--module sfgs_jax] [--runs 5]

One run beforehand fills the file cache and compiles bytecode. The fastest run tells what the import takes
when nothing else wants the machine. A package is charged with its own modules, not with those that they
import. *for* names the module of the library that imported a package first.
"""

import argparse
import re
import subprocess
import sys
from collections import defaultdict
from typing import NamedTuple

PACKAGES = 15
_LINE = re.compile(r"import time: +(\d+) \| +\d+ \|( +)(\S+)")


class Package(NamedTuple):
    """A package's share of an import."""

    name: str
    milliseconds: float
    first_for: str


def processor_and_wall_time(module: str) -> tuple[float, float]:
    """Seconds of an import in a fresh process: processor time and wall time."""
    code = (
        "import time; p, w = time.process_time(), time.perf_counter(); "
        f"import {module}; print(time.process_time() - p, time.perf_counter() - w)"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    processor, wall = map(float, printed.split())
    return processor, wall


def packages(module: str) -> list[Package]:
    """Packages that an import brings in, the heaviest first, by Python's own clock."""
    command = [sys.executable, "-X", "importtime", "-c", f"import {module}"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stderr.splitlines()
    found = [match for line in lines if (match := _LINE.fullmatch(line))]
    own, first = defaultdict(float), {}
    importers: list[tuple[int, str]] = []
    # A module is printed after what it imports, so backwards it comes before.
    for match in reversed(found):
        microseconds, depth, name = int(match[1]), len(match[2]), match[3]
        while importers and importers[-1][0] >= depth:
            importers.pop()
        package = name.split(".")[0]
        own[package] += microseconds / 1e3
        inner = [importer for _, importer in importers if importer.split(".")[0] == module.split(".")[0]]
        first[package] = inner[-1] if inner else ""
        importers.append((depth, name))
    rows = [Package(name, time, first[name]) for name, time in own.items()]
    return sorted(rows, key=lambda row: -row.milliseconds)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--module", default="sfgs_jax", help="The module to import.")
    parser.add_argument("--runs", type=int, default=5, help="Fresh processes, of which the fastest counts.")
    arguments = parser.parse_args()
    processor_and_wall_time(arguments.module)
    times = [processor_and_wall_time(arguments.module) for _ in range(arguments.runs)]
    processor, wall = (min(column) for column in zip(*times, strict=True))
    print(f"import {arguments.module}: {wall:.2f} s, {processor:.2f} s of processor time")
    print(f"{'package':24} {'ms':>6}  for")
    for row in packages(arguments.module)[:PACKAGES]:
        print(f"{row.name:24} {row.milliseconds:6.0f}  {row.first_for}")


if __name__ == "__main__":
    main()
