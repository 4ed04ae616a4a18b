"""Who pulls the object apart: the log of a pair of arms, the causes by newtons, and the cell that has them.

python examples/blame_a_log.py
"""

from pathlib import Path

import coop_pin as cp

FOLDER = Path(__file__).parent / "real_pair"

if __name__ == "__main__":
    answer = cp.blame(FOLDER / "log.csv", FOLDER / "cell.toml")
    print(answer.summary())
    first = answer.causes[0]
    print(f"first: {first.name}, {first.newtons:.2f} N ({first.low:.2f} to {first.high:.2f})")
    erring = answer.with_errors()  # a scenario for cp.run, with the errors of the log
    print(erring.cell.arms["right"].calibration_error.base.xyz)
