"""``python -m formctl``: the same as the installed ``formctl``."""

from formctl.cli import main

if __name__ == "__main__":
    main()
