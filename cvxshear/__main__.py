"""python -m cvxshear is the command line."""

from cvxshear.cli import main

main()
