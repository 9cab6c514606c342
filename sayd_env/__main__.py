"""``python -m sayd_env`` is ``sayd``."""

from sayd_env.cli import program

if __name__ == "__main__":
    program()
