"""``python -m sayd_env`` is ``sayd``."""

from sayd_env.cli import start

if __name__ == "__main__":
    start()
