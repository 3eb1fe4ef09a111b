"""Height errors of a workspace against its capture's truth.

    python benchmarks/painting_height.py WORKSPACE TRUTH

Prints the table and ends with status 1 if a target is missed: median at most 60 um, 99th percentile
at most 0.4 mm, over at least 98 % of the canvas.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.formats.height_field import HEIGHT
from pipeline.formats.reflectance_maps import MAPS
from pipeline.report.truth import errors_against_truth

TARGETS = {"median_mm": 0.060, "p99_mm": 0.4}
COVERAGE = 0.98


def main(workspace: Path, truth: Path) -> int:
    """Print the table; return 1 if a target is missed."""
    fitted = all((workspace / file).is_file() for file in MAPS.files)
    errors = errors_against_truth(
        HEIGHT.load(workspace), truth, maps=MAPS.load(workspace) if fitted else None
    )
    for what, value, unit in errors.rows():
        print(f"{what:44} {value:10.3f} {unit}")
    missed = [
        f"{name} is {getattr(errors, name):.3f}, at most {limit}"
        for name, limit in TARGETS.items()
        if getattr(errors, name) > limit
    ]
    if errors.coverage < COVERAGE:
        missed.append(f"coverage is {errors.coverage:.3f}, at least {COVERAGE}")
    for text in missed:
        print(f"target missed: {text}")
    return bool(missed)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: painting_height.py WORKSPACE TRUTH")
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
