"""``python -m mic`` is the command ``mic``."""

from mic.cli import main

if __name__ == "__main__":
    main()
