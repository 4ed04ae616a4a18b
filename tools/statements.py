"""Number of statements in each package of coop_pin: ast.stmt nodes, less docstrings and bare strings."""

import ast
import collections
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "coop_pin"


def statements(source: str) -> int:
    """Return the number of statements of a module's source, docstrings and bare strings apart."""
    return sum(
        isinstance(node, ast.stmt)
        and not (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        )
        for node in ast.walk(ast.parse(source))
    )


def table() -> dict[str, tuple[int, int]]:
    """Return files and statements of each package or module at the top of coop_pin."""
    counts = collections.defaultdict(list)
    for file in sorted(PACKAGE.rglob("*.py")):
        top = file.relative_to(PACKAGE).parts[0].removesuffix(".py")
        counts[top].append(statements(file.read_text(encoding="utf-8")))
    return {top: (len(sizes), sum(sizes)) for top, sizes in counts.items()}


if __name__ == "__main__":
    rows = table()
    rows["coop_pin"] = tuple(map(sum, zip(*rows.values(), strict=True)))
    print(f"{'package':20} {'files':>5} {'statements':>10}")
    for name, (files, size) in rows.items():
        print(f"{name:20} {files:5} {size:10}")
