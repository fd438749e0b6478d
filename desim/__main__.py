"""`python -m desim` is the command `desim`."""

from desim.cli import main

if __name__ == "__main__":
    main()
