"""Policies side by side on conditions that none was tuned or trained on."""
