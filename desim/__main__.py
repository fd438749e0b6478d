"""Entry point of the command `desim` and of `python -m desim`."""

import sys

try:
    from desim.cli import main
except KeyboardInterrupt:  # the import takes a while, and a traceback through it says nothing
    print("interrupted", file=sys.stderr)
    sys.exit(130)

if __name__ == "__main__":
    main()
