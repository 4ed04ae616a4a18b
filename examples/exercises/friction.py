"""Exercise 5: bias or friction? Poses are exchanged or wrenches are measured; which one does a cell need?"""

from mean_pose import compared

VISCOUS = [1.35, 1.26, 1.215]
FRICTION = {"viscous": VISCOUS, "coulomb": 2.0, "stiction": 3.0}

TRIALS = {
    "one arm off by 1 mm": None,
    "2 N m Coulomb, 3 N m stiction": {f"cell.arms.{arm}.friction": FRICTION for arm in ("left", "right")},
}

if __name__ == "__main__":
    print("adept-anchored, 5 s, from 2 s on: position, mm rms, and internal force, N rms")
    for trial, changes in TRIALS.items():
        for law, (position, force) in compared("adept-anchored", changes).items():
            print(f"{trial:30} {law:11} {position:7.3f} {force:9.3f}")
