"""Parts of an installation of coop_pin with their versions and licences (software bill of materials).

    python tools/sbom.py                          # a table
    python tools/sbom.py --cyclonedx > sbom.json  # CycloneDX 1.6
    python tools/sbom.py --extra notebook sweep   # with the requirements of extras

What is installed in this Python's environment is listed: the same environment gives the same bytes.
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

UPLOT = Path(__file__).parents[1] / "coop_pin" / "viz" / "web" / "uplot"
"""The script that is part of the package; three.js comes with meshcat."""


def distributions(name: str, extras: frozenset[str] = frozenset()) -> dict[str, metadata.Distribution]:
    """Return a distribution and all that it requires here, by name; what is not installed is left out."""
    found, left, seen = (
        dict[str, metadata.Distribution](),
        [(name, extras)],
        set[tuple[str, frozenset[str]]](),
    )
    while left:
        name, extras = left.pop()
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        try:
            found[name] = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue
        for line in found[name].requires or ():
            requirement = Requirement(line)
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in extras | {""}):
                left.append((canonicalize_name(requirement.name), frozenset(requirement.extras)))
    return dict(sorted(found.items()))


def licence(distribution: metadata.Distribution) -> str:
    """Return the licence that a distribution states: an expression, classifiers, or the head of a text."""
    told: Any = distribution.metadata
    if expression := told.get("License-Expression"):
        return str(expression)
    named = [
        entry.rpartition(" :: ")[2] for entry in told.get_all("Classifier") or () if "License ::" in entry
    ]
    head = (told.get("License") or "").strip().split("\n")[0][:80]
    return ", ".join(sorted(named)) or head or "not stated"


def cyclonedx(parts: dict[str, metadata.Distribution]) -> dict[str, Any]:
    """Return the parts as a CycloneDX 1.6 document."""

    def component(name: str, part: metadata.Distribution) -> dict[str, Any]:
        reference = f"pkg:pypi/{name}@{part.version}"
        kind = "application" if name == "coop-pin" else "library"
        licences = [{"license": {"name": licence(part)}}]
        return {
            "type": kind,
            "bom-ref": reference,
            "name": name,
            "version": part.version,
            "purl": reference,
            "licenses": licences,
        }

    components = [component(name, part) for name, part in parts.items()]
    (own,) = (entry for entry in components if entry["name"] == "coop-pin")
    script = {
        "type": "library",
        "bom-ref": "pkg:npm/uplot",
        "name": "uplot",
        "purl": "pkg:npm/uplot",
        "licenses": [{"license": {"id": "MIT"}}],
    }
    others = [entry for entry in components if entry is not own]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": own},
        "components": [*others, script],
    }


def main() -> None:
    """Print the table or the document."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cyclonedx", action="store_true")
    parser.add_argument("--extra", nargs="*", default=[])
    options = parser.parse_args()
    parts = distributions("coop-pin", frozenset(options.extra))
    if options.cyclonedx:
        json.dump(cyclonedx(parts), sys.stdout, indent=2)
        print()
    else:
        for name, part in parts.items():
            print(f"{name:<24} {part.version:<14} {licence(part)}")
        print(f"{'uplot':<24} {'(script)':<14} {(UPLOT / 'LICENSE').read_text().split(chr(10))[0]}")


if __name__ == "__main__":
    main()
