"""Environments of Gymnasium (extra ``gym``): a cell for agents, one at a time or as lanes of a batch."""
