"""What the best possible controller could reach."""
