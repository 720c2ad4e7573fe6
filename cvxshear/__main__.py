"""python -m cvxshear, and the command cvxshear, are the command line."""

import sys


def main() -> None:
    """Run the command line; one that is interrupted while it loads ends as one that is interrupted later."""
    try:
        from cvxshear.cli import main as run  # noqa: PLC0415 - here an interruption while it loads is caught

        run()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
