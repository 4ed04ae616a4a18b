"""Run experiments of the zoo, and write their pages and pictures in docs/zoo and docs/images.

python tools/zoo.py                      # all of them
python tools/zoo.py object-impedance     # some of them
python tools/zoo.py --list               # only the page of the methods, which needs no run
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from pathlib import Path

from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.zoo import Experiment, Reproduction

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "studies"))
from pages import markdown, save_image, with_block  # noqa: E402

PAGES, IMAGES = REPOSITORY / "docs" / "zoo", REPOSITORY / "docs" / "images"
METHODS = PAGES / "methods.md"
DASHES = (("--", "0.35"), (":", "0.1"), ("-.", "0.6"))
"""Form and grey of the dashed curves of a picture, in turn."""


def bullets(texts: tuple[str, ...]) -> str:
    """Return a list."""
    return "\n".join(f"- {text}" for text in texts)


def page(experiment: Experiment, run: Reproduction) -> str:
    """Return the page of an experiment with the numbers of a run."""
    folder = f"coop_pin/zoo/{experiment.name.replace('-', '_')}"
    claims, numbers = [], []
    for count, claim in enumerate(experiment.claims, 1):
        claims.append((f"{count}. {claim.text}", claim.where, claim.theirs, f"**{run.verdict(claim.name)}**"))
        for number in run.numbers:
            if number.claim == claim.name:
                value = f"{number.value:.3g} {number.unit}".strip()
                mark = "-" if not number.decides else "yes" if number.holds else "no"
                numbers.append((str(count), number.text, value, number.limit, mark))
    unjudged = tuple(f"{claim.text} {claim.unjudged}" for claim in experiment.claims if claim.unjudged)
    return f"""# {experiment.title}

*Kind: {experiment.kind}.* {experiment.cell}

- **Source**: {experiment.source}.
- **What could be read of it**: {experiment.had}

```sh
coop-pin zoo {experiment.name}
```

![{experiment.picture.caption}](../images/zoo-{experiment.name}.png)

{experiment.picture.caption}

## Claims and verdicts

{markdown(("claim, in our words", "stated in", "theirs", "verdict"), claims)}

{markdown(("claim", "measured", "number", "limit", "within"), numbers)}
{
        f'''
Not judged:

{bullets(unjudged)}
'''
        if unjudged
        else ""
    }
## What the source does not state, and what was chosen

{bullets(experiment.chosen)}

## What deviates, and why

{bullets(experiment.deviations)}

Scenarios and code are in `{folder}`.
"""


def verdicts(name: str) -> str:
    """Return the verdicts of a page, in the order of its claims."""
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    return "; ".join(re.findall(r"^\| \d\. .*\| \*\*([a-z ]+)\*\* \|$", text, re.MULTILINE))


def methods() -> str:
    """Return the table of methods by what they measure and command."""
    rows = [
        (f"[{one.kind}]({name}.md)", one.measures, one.commands, one.messages, one.knows, verdicts(name))
        for name in cp.zoo.experiment_names()
        for one in (cp.zoo.load_experiment(name),)
    ]
    return markdown(
        ("kind", "each arm measures", "commands", "messages", "is told", "verdicts, by claims"), sorted(rows)
    )


def save_picture(experiment: Experiment, run: Reproduction) -> Path:
    """Draw the curves of a run."""
    figure = Figure(figsize=(6.4, 3.7), layout="constrained")
    panel = figure.subplots()
    dashes = itertools.cycle({"linestyle": form, "color": grey, "zorder": 3} for form, grey in DASHES)
    for curve in run.curves:
        style = next(dashes) if curve.dashed else {"linewidth": 1.4}
        panel.plot(curve.x, curve.y, label=curve.label, **style)
    panel.set(xlabel=experiment.picture.x, ylabel=experiment.picture.y)
    panel.set_yscale("log" if experiment.picture.log else "linear")
    panel.grid(visible=True, alpha=0.25)
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    return save_image(figure, IMAGES / f"zoo-{experiment.name}")


def numbers_of(text: str) -> tuple[str, list[float]]:
    """Return a page without its numbers, and the numbers."""
    form = r"(?<![\w.:])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w:]|\.\d)"
    return re.sub(form, "#", text), [float(number) for number in re.findall(form, text)]


def main() -> None:
    """Run the named experiments, write their pages, and the table of methods."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--list", action="store_true", help="write only the page of the methods")
    options = parser.parse_args()
    for name in [] if options.list else options.names or cp.zoo.experiment_names():
        experiment = cp.zoo.load_experiment(name)
        run = experiment.run()
        print(run.summary(), end="\n\n")
        (PAGES / f"{experiment.name}.md").write_text(page(experiment, run), encoding="utf-8")
        save_picture(experiment, run)
    METHODS.write_text(
        with_block(METHODS.read_text(encoding="utf-8"), "methods", methods()), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
