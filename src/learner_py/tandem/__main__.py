"""`python -m tandem`: the command line (see tandem.cli)."""

from tandem.cli import main

if __name__ == "__main__":
    main()
