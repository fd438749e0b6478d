"""Entry point of `python -m desim`, which runs the command `desim`."""

from desim.cli import main

if __name__ == "__main__":
    main()
