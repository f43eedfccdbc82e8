"""All benchmarks in order, each in a fresh process (about two and a half hours; quick forms: a third of one).

`python -m benchmarks` rewrites the sections and plots of README.md; `--quick` runs the short forms and only
prints; `--only accuracy roller` runs those two. One that fails does not stop the others.
"""

import argparse
import ast
import subprocess
import sys
import time
from pathlib import Path

from benchmarks._common import uncached

FOLDER = Path(__file__).parent
NAMES = (
    "accuracy",
    "pinch",
    "space",
    "contours",
    "location",
    "work_precision",
    "batch",
    "lanes",
    "maps",
    "sweeps",
    "stiffness",
    "long_pinch",
    "disc",
    "roller",
    "gradients",
    "costs",
    "machinery",
    "first_calls",
    "design",
    "gpu",
    "stress",
    "reaching",
    "scans",
    "suite",
)


def about(name: str) -> str:
    """First line of a benchmark's docstring; nothing is imported."""
    path = FOLDER / f"{name}.py"
    text = ast.get_docstring(ast.parse(path.read_text())) if path.exists() else None
    return (text or "not there").splitlines()[0]


def run(name: str, quick: bool) -> bool:
    """Whether one benchmark ran to its end; what it prints is passed on."""
    print(f"== {name}: {about(name)}", flush=True)
    start = time.perf_counter()
    option = "--quick" if quick else "--write"
    call = [sys.executable, "-m", f"benchmarks.{name}", option]
    good = subprocess.run(call, cwd=FOLDER.parent, env=uncached(), check=False).returncode == 0
    print(f"== {name}: {'done' if good else 'FAILED'} in {time.perf_counter() - start:.0f} s", flush=True)
    return good


def main() -> None:
    text = "\n".join([__doc__ or "", *(f"  {name}: {about(name)}" for name in NAMES)])
    shown = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m benchmarks", description=text, formatter_class=shown)
    parser.add_argument("--quick", action="store_true", help="short forms; print only")
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES, metavar="NAME", help="these alone")
    options = parser.parse_args()
    failed = [name for name in NAMES if name in options.only and not run(name, options.quick)]
    if failed:
        print(f"failed: {', '.join(failed)}")
        sys.exit(1)


if __name__ == "__main__":
    main()
