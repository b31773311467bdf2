"""The command line `nonrigid`, as `python -m nonrigid` too."""

import sys

from ._nonrigid import command_line
from ._program import how


def main() -> None:
    """Runs the command line of this process, and ends it."""
    program, first = how()
    sys.exit(command_line(["nonrigid", *sys.argv[1:]], program, first))


if __name__ == "__main__":
    main()
