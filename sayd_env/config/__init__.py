"""Typed, validated configuration: the only way from YAML into the program."""

from sayd_env.config.base import Model, quantity
from sayd_env.config.errors import ConfigError, DataError, SaydError, StudyError
from sayd_env.config.loader import (
    apply_overrides,
    nearest,
    packaged_names,
    parse_yaml,
    read_config,
    read_text,
    validate,
)

__all__ = [
    "ConfigError",
    "DataError",
    "Model",
    "SaydError",
    "StudyError",
    "apply_overrides",
    "nearest",
    "packaged_names",
    "parse_yaml",
    "quantity",
    "read_config",
    "read_text",
    "validate",
]
