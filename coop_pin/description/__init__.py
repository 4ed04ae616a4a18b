"""Configuration classes (frozen, validated): scenario, cell, arm, payload, controller, events, plant."""
