"""Cell: arms, mobile bases, payload, grasps, contacts and closures, as a scenario states them."""
