"""Learned controllers: the batch environment for Stable-Baselines3, training, and policies on disk.

The only place that imports torch and Stable-Baselines3; `sayd bench` alone sets torch's threads. This package
itself and `agents.policy_file` do without them: what was learned runs with NumPy alone.
"""
