"""Results, scenarios and reports as files that load to the same values. Usage: save_and_load.py [FOLDER]"""

import sys
from pathlib import Path

import coop_pin as cp
from coop_pin.viz import save_report

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/save_and_load")
result = cp.run("adept-paper", {"duration": 1.0, "events": []})

result.save(folder / "result.nc")
result.scenario.save(folder / "scenario.toml")
save_report(result, folder / "report.html")

again = cp.RunResult.load(folder / "result.nc")
print("the same numbers:   ", again.data.identical(result.data))
print("the same scenario:  ", cp.Scenario.load(folder / "scenario.toml") == again.scenario == result.scenario)
print("and it runs again to the same bits:", cp.run(again.scenario).data.identical(result.data))
