"""YAML data: the only home of numbers with physical meaning (read through `sayd_env.config`)."""
