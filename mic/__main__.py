"""``python -m mic``: the command."""

from mic.cli import main

if __name__ == "__main__":
    main()
