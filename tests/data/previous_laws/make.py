import coop_pin as cp
from coop_pin.comparison.controllers import controllers_for

s = cp.Scenario.load("adept-anchored").override(
    {"events": (), "sensors.wrist": {}, "duration": 0.1, "clock.record_every": 4}
)
laws = controllers_for(s, ["prescribed-performance", "leader-follower", "computed-torque", "adaptive"])
base = s.override({"controller": laws["leader-follower"]})
base.save("scenario.toml")
cp.sweep(
    base,
    {"controller.options.pose_gain": [2.0, 3.0]},
    cases={
        "law": {n: {} if n == "leader-follower" else {"controller": laws[n]} for n in ("leader-follower",)}
    },
    out="sweep",
    workers=0,
    quiet=True,
)
cp.compare(
    s.replace(name="small"),
    {**{n: laws[n] for n in ("prescribed-performance", "computed-torque")}},
    ["nominal"],
    out="comparison",
    duration=0.1,
    workers=0,
    quiet=True,
)
