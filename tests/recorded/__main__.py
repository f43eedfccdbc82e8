"""`python -m tests.recorded`: what differs from the records, or with `--write` those records anew."""

import argparse
import os
from collections.abc import Callable
from typing import Any

from tests import conftest

os.environ.setdefault("XLA_FLAGS", conftest.QUICKLY)

from tests.recorded import compare, fits, pictures, scene_numbers, signatures, texts  # noqa: E402

# Digits that a record keeps; the states from which pictures start keep all.
_DIGITS = {"closed_states": 17, "scene": 12}


def records() -> dict[str, Callable[[], Any]]:
    """By name of every record, how it is made; pictures start from the closed states."""
    found: dict[str, Callable[[], Any]] = {"closed_states": scene_numbers.closed}
    for name in scene_numbers.scene_names():
        found[f"scene_{name}"] = lambda name=name: scene_numbers.numbers(name)
    for module in signatures.modules():
        found[f"signatures_{module}"] = lambda module=module: signatures.signatures(module)
    found |= {f"network_{name}": lambda name=name: fits.of_network(name) for name in fits.NETWORKS}
    found["pinched"] = scene_numbers.pinched
    found["held_at"] = scene_numbers.held_at
    found |= {f"fitted_{name}": lambda name=name: fits.numbers(name) for name in fits.FITS}
    found |= {f"text_{name}": make for name, make in texts.TEXTS.items()}
    return found | pictures.PICTURES


def main() -> None:
    """Compare or write the records."""
    parser = argparse.ArgumentParser("python -m tests.recorded", description=__doc__)
    parser.add_argument("names", nargs="*", help="which records (default: all)")
    parser.add_argument("--write", action="store_true", help="take what is now as the record")
    options = parser.parse_args()
    known = records()
    unknown = [name for name in options.names if name not in known]
    if unknown:
        parser.error(f"there is no record {unknown[0]}; there are {', '.join(known)}")
    for name in options.names or known:
        found = known[name]()
        if options.write:
            compare.write(name, found, _DIGITS.get(name.split("_")[0], _DIGITS.get(name, 7)))
            continue
        try:
            compare.check(name, found)
        except (AssertionError, FileNotFoundError) as error:
            print(error)
    if options.write and not options.names:
        for path in compare.RECORDS.glob("*.json"):
            if path.stem not in known:
                path.unlink()


if __name__ == "__main__":
    main()
