"""Runs of a vehicle, with a policy or without: rollouts, metrics, run cache, executors."""
