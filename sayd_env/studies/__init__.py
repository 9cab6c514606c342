"""One module per question a person asks: a function from a configuration to a result, and its plots."""
