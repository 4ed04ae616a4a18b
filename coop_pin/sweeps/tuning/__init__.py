"""The search for gains: what is wanted, what was tried, and two ways to choose what to try next."""
