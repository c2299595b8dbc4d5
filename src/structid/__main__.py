"""`python -m structid`, the same as the command `structid`."""

from structid.cli.app import main

main()
