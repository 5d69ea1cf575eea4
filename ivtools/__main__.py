"""`python -m ivtools`, where the command is not on the path."""

from ivtools.cli import main

if __name__ == "__main__":
    main()
