"""The `polarfield` command."""

import sys

from pipeline.engine.cli import main as run_command
from stages import STAGES


def main() -> None:
    """Run `polarfield` with the arguments of this process."""
    sys.exit(run_command(STAGES, sys.argv[1:]))


if __name__ == "__main__":
    main()
