"""Run the system on the synthetic room and the real recordings, and print the figures of each run.

    python -m experiments.recordings [--realtime] [--refine SECONDS] [--out DIR] [NAME ...]

Each run is a process of its own, as a user would start it. So its time includes imports, compilation,
evaluation and report, and its memory is its own. Real recordings are found through SFGS_DATA, by default
`../shared`. *First frame* is the compilation of everything and the first frame with its mapping. *Frames/s
with mapping* leaves it out, and counts the work of mapping in the loop, not that after the last frame. With
--realtime recordings play by their own clock, and mapping runs beside tracking. Frames that came while
another was tracked are *dropped*, and frames/s then say nothing. docs/evaluation.md explains the protocols of
the PSNR. The table is in Markdown; experiments/results.md keeps the last one.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DATA = Path(os.environ.get("SFGS_DATA", "../shared")) / "data"
SOURCES = {
    "synthetic": "synthetic",
    "synthetic-noise": "synthetic:noise=1",
    "synthetic-640": "synthetic:frames=120,width=640,height=480",
    "redkitchen": str(DATA / "7scenes" / "redkitchen"),
    "fr1_rpy": str(DATA / "tum" / "rgbd_dataset_freiburg1_rpy"),
}
COLUMNS = (
    "recording",
    "frames",
    "tracked",
    "dropped",
    "ATE RMSE cm",
    "PSNR all dB",
    "gs_icp",
    "with exposure",
    "views / held out",
    "SSIM all",
    "Gaussians",
    "map steps",
    "tracking ms median / p95",
    "frames/s with mapping",
    "first frame s",
    "whole run s",
    "peak MB",
)


def measure(name: str, folder: Path, options: list[str]) -> tuple[str, ...]:
    """Run one recording and give its row of the table."""
    command = [
        sys.executable,
        "-m",
        "sfgs_jax",
        "run",
        SOURCES[name],
        "--out",
        str(folder),
        "--overwrite",
        *options,
    ]
    start = time.perf_counter()
    subprocess.run(command, check=True)
    seconds = time.perf_counter() - start
    metrics = json.loads((folder / "metrics.json").read_text())
    frames, tracking = metrics["frames"], metrics["stages"]["tracking"]
    stages = metrics["stages"]
    first = stages["compilation"]["total_s"] + stages["frame"]["first_ms"] / 1e3
    return (
        name,
        str(frames["total"]),
        str(frames["tracked"]),
        str(frames["dropped"]),
        f"{100 * metrics['ate']['rmse_m']:.2f}",
        *(f"{metrics['psnr'][protocol]:.2f}" for protocol in ("all", "gs_icp", "gs_icp_exposure")),
        f"{metrics['psnr']['views']:.2f} / {metrics['psnr']['held_out']:.2f}",
        f"{metrics['ssim']['all']:.3f}",
        str(metrics["map"]["gaussians"]),
        str(metrics["map"]["steps"]),
        f"{tracking['median_ms']:.0f} / {tracking['p95_ms']:.0f}",
        f"{metrics['fps']['frames']:.1f}",
        f"{first:.1f}",
        f"{seconds:.0f}",
        f"{metrics['memory']['peak_mb']:.0f}",
    )


def main() -> None:
    """Measure the recordings named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(SOURCES)}; all if none is given"
    )
    parser.add_argument(
        "--out", type=Path, default=None, help="folder for the runs; a temporary one if not given"
    )
    parser.add_argument("--realtime", action="store_true", help="play the recordings by their own clock")
    parser.add_argument("--refine", type=float, default=None, help="seconds of refinement")
    arguments = parser.parse_args()
    options = ["--realtime"] if arguments.realtime else []
    options += [] if arguments.refine is None else ["--refine", str(arguments.refine)]
    out = arguments.out or Path(tempfile.mkdtemp(prefix="sfgs-recordings-"))
    rows = [measure(name, out / name, options) for name in arguments.names or SOURCES]
    print(f"\nruns: {out}\n")
    for row in (COLUMNS, tuple("---" for _ in COLUMNS), *rows):
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
