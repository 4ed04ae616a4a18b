"""coop_pin: cooperative closed-chain manipulators on Pinocchio."""
